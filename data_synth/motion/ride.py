"""A schedule along a way, as series in time that the motions are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.motion.pace import Schedule
from data_synth.motion.smooth import smoothed
from data_synth.motion.way import Way
from vo.types import Floats


@dataclass(frozen=True, eq=False)
class Ride:
    """What happens along the way, at N equally spaced times.

    Attributes:
        times_s: (N,).
        step_s: between them.
        points: (N, 3) x, y and the levelled ground below.
        heading: (N,) direction of the way, radians, without jumps.
        slope: (N,) angle by which the way rises.
        ahead_m_s2: (N,) acceleration along the way.
        left_m_s2: (N,) horizontal acceleration across it.
        stir: (N,) speed as a share 0…1 of the usual one: how much a walker bobs and wheels shake.
    """

    times_s: Floats
    step_s: float
    points: Floats
    heading: Floats
    slope: Floats
    ahead_m_s2: Floats
    left_m_s2: Floats
    stir: Floats

    def smoothed(self, values: Floats, seconds: float) -> Floats:
        """A series (N,) smoothed over a time."""
        return smoothed(values, seconds / self.step_s)


def make_ride(way: Way, schedule: Schedule, times_s: Floats, ease_s: float) -> Ride:
    """Follow a schedule along a way, with changes of speed eased over a time."""
    step = float(times_s[1] - times_s[0])
    distances = smoothed(schedule.at(times_s), ease_s / step)
    speeds = np.gradient(distances, step)
    first, second = way.at(distances, 1), way.at(distances, 2)
    flat = np.hypot(first[:, 0], first[:, 1])
    bend = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / flat**2
    usual = max(float(np.median(np.abs(speeds))), 0.3)
    return Ride(
        times_s=times_s,
        step_s=step,
        points=way.at(distances),
        heading=np.unwrap(np.arctan2(first[:, 1], first[:, 0])),
        slope=np.arctan2(first[:, 2], flat),
        ahead_m_s2=np.gradient(speeds, step),
        left_m_s2=speeds**2 * bend,
        stir=smoothed(np.minimum(np.abs(speeds) / usual, 1.0), 0.5 / step),
    )


def stay(way: Way, at_m: float, times_s: Floats) -> Ride:
    """Stand at one place of a way."""
    step = float(times_s[1] - times_s[0])
    still = Schedule(np.array([0.0, 1.0]), np.array([at_m, at_m]), np.zeros(2))
    return make_ride(way, still, times_s, step)
