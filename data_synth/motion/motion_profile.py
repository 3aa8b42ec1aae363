"""Motion along a route as time series, from which the carriers derive poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.motion.route import Route, smoothed
from data_synth.motion.speed_profile import Schedule
from vo.base.types import Floats


@dataclass(frozen=True, eq=False)
class MotionProfile:
    """Position, direction and acceleration along a route at N equally spaced times."""

    times_s: Floats  # (N,)
    step_s: float
    points: Floats  # (N, 3) x, y and the averaged height of the ground
    heading: Floats  # (N,) direction of the route, radians, without jumps
    slope: Floats  # (N,) angle of ascent of the route
    ahead_m_s2: Floats  # (N,) acceleration along the route
    left_m_s2: Floats  # (N,) horizontal acceleration across it
    relative_speed: Floats  # (N,) speed relative to the usual one, 0…1; scales bobbing and shaking

    def smoothed(self, values: Floats, seconds: float) -> Floats:
        """Smooth a series (N,) over a time."""
        return smoothed(values, seconds / self.step_s)


def make_profile(route: Route, schedule: Schedule, times_s: Floats, ease_s: float) -> MotionProfile:
    """Follow a schedule along a route, with changes of speed eased over a time."""
    step = float(times_s[1] - times_s[0])
    distances = smoothed(schedule.at(times_s), ease_s / step)
    speeds = np.gradient(distances, step)
    first, second = route.at(distances, 1), route.at(distances, 2)
    flat = np.hypot(first[:, 0], first[:, 1])
    bend = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / flat**2
    usual = max(float(np.median(np.abs(speeds))), 0.3)
    return MotionProfile(
        times_s=times_s,
        step_s=step,
        points=route.at(distances),
        heading=np.unwrap(np.arctan2(first[:, 1], first[:, 0])),
        slope=np.arctan2(first[:, 2], flat),
        ahead_m_s2=np.gradient(speeds, step),
        left_m_s2=speeds**2 * bend,
        relative_speed=smoothed(np.minimum(np.abs(speeds) / usual, 1.0), 0.5 / step),
    )


def stationary_profile(route: Route, at_m: float, times_s: Floats) -> MotionProfile:
    """Profile of standing at one point of a route."""
    step = float(times_s[1] - times_s[0])
    still = Schedule(np.array([0.0, 1.0]), np.array([at_m, at_m]), np.zeros(2))
    return make_profile(route, still, times_s, step)
