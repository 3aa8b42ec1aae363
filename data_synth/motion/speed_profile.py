"""Speeds and schedules along a route, within limits of speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.motion.limits import Limits
from data_synth.motion.route import Route
from vo.base.errors import ConfigError
from vo.base.types import Floats

# Fraction of the limits for the plan; the rest is for easing, bumps and rounding.
_PLANNED = 0.75

_MIN_SQUARE_M2_S2 = 1e-6


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Largest speed at each point of a closed route."""

    squared_speeds: Floats  # (M,) squared speeds that the tangential acceleration can reach, m²/s²
    step_m: float
    tangential_m_s2: float  # largest acceleration along the route

    @property
    def length_m(self) -> float:
        """Length of the route."""
        return len(self.squared_speeds) * self.step_m

    @property
    def lap_s(self) -> float:
        """Duration of one lap without a stop."""
        return float(np.sum(self.step_m / np.sqrt(self.squared_speeds)))

    def limited(self, speed_m_s: float) -> SpeedProfile:
        """The same profile with a lower top speed."""
        return SpeedProfile(
            np.minimum(self.squared_speeds, speed_m_s**2), self.step_m, self.tangential_m_s2
        )


@dataclass(frozen=True, eq=False)
class Schedule:
    """Distances along a route by time, with constant acceleration between the rows."""

    times_s: Floats  # (N,) increasing, from 0
    distances_m: Floats  # (N,)
    speeds_m_s: Floats  # (N,) negative when going back

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return float(self.times_s[-1])

    def at(self, times_s: Floats) -> Floats:
        """Distances at times; at rest before the start and after the end."""
        inside = np.clip(times_s, 0.0, self.times_s[-1])
        row = np.clip(np.searchsorted(self.times_s, inside, "right") - 1, 0, len(self.times_s) - 2)
        since = inside - self.times_s[row]
        gain = np.diff(self.speeds_m_s) / np.maximum(np.diff(self.times_s), 1e-12)
        return np.asarray(
            self.distances_m[row] + since * (self.speeds_m_s[row] + 0.5 * since * gain[row])
        )


def make_speed_profile(route: Route, limits: Limits, speed: float) -> SpeedProfile:
    """The largest speeds within the limits, in curves too; `speed` scales the top speed."""
    step = route.step_m
    places = np.arange(len(route.controls), dtype=np.float64) * step
    curvatures = np.maximum(route.curvatures(places), 1e-9)
    squared_speeds = np.minimum(
        _PLANNED * limits.lateral_m_s2 / curvatures,
        (_PLANNED * limits.turn_rad_s / curvatures) ** 2,
    )
    squared_speeds = np.clip(squared_speeds, _MIN_SQUARE_M2_S2, (limits.speed_m_s * speed) ** 2)
    tangential = _PLANNED * limits.tangential_m_s2
    return SpeedProfile(_reachable(squared_speeds, 2.0 * tangential * step), step, tangential)


def _reachable(squared_speeds: Floats, gain: float) -> Floats:
    """The largest closed series below another one that changes by at most `gain` a step."""
    count = len(squared_speeds)
    three = np.tile(squared_speeds, 3)
    ramp = gain * np.arange(3 * count)
    rising = np.minimum.accumulate(three - ramp) + ramp
    falling = (np.minimum.accumulate((three + ramp)[::-1]))[::-1] - ramp
    return np.asarray(np.minimum(rising, falling)[count : 2 * count])


def leg(speed_profile: SpeedProfile, start_m: float, end_m: float) -> Schedule:
    """Schedule from rest at one point to rest at another, forwards or backwards."""
    low, high = sorted((start_m, end_m))
    # At least one row between the ends, with a speed above 0.
    count = 3 + int((high - low) / speed_profile.step_m)
    distances = np.linspace(low, high, count)
    lap = np.append(speed_profile.squared_speeds, speed_profile.squared_speeds[0])
    squared_speeds = np.interp(
        distances % speed_profile.length_m / speed_profile.step_m, np.arange(len(lap)), lap
    )
    twice = 2.0 * speed_profile.tangential_m_s2
    squared_speeds = np.minimum(
        squared_speeds, twice * np.minimum(distances - low, high - distances)
    )
    speeds = np.sqrt(np.maximum(squared_speeds, 0.0))
    steps = 2.0 * np.diff(distances) / (speeds[1:] + speeds[:-1])
    if end_m < start_m:
        distances, speeds, steps = distances[::-1], -speeds[::-1], steps[::-1]
    return Schedule(np.concatenate([[0.0], np.cumsum(steps)]), distances, speeds)


def rest(at_m: float, seconds: float) -> Schedule:
    """Schedule of standing still."""
    return Schedule(np.array([0.0, seconds]), np.array([at_m, at_m]), np.zeros(2))


def chain(parts: list[Schedule]) -> Schedule:
    """Schedules one after the other."""
    starts = np.concatenate([[0.0], np.cumsum([part.duration_s for part in parts])])
    return Schedule(
        np.concatenate([p.times_s + s for p, s in zip(parts, starts[:-1], strict=True)]),
        np.concatenate([p.distances_m for p in parts]),
        np.concatenate([p.speeds_m_s for p in parts]),
    )


# Extra time for smoothing, and for the inertial samples after the last frame.
_BEYOND_S = 6.0

_BISECTIONS = 40


def drive_on(speed_profile: SpeedProfile, seconds: float) -> Schedule:
    """Start from rest and drive on beyond the end of the recording."""
    top_m_s = float(np.sqrt(speed_profile.squared_speeds.max()))
    braking_m = top_m_s**2 / (2.0 * speed_profile.tangential_m_s2)
    laps = (seconds + _BEYOND_S) / speed_profile.lap_s
    return leg(speed_profile, 0.0, laps * speed_profile.length_m + braking_m)


def stop_and_go(
    speed_profile: SpeedProfile, seconds: float, ease_s: float, rng: np.random.Generator
) -> Schedule:
    """Alternate between driving and standing; reverse a short distance after the second stop."""
    usual_m_s = speed_profile.length_m / speed_profile.lap_s
    parts: list[Schedule] = []
    at, elapsed = 0.0, 0.0
    while elapsed < seconds + _BEYOND_S:
        going_s = float(rng.uniform(4.0, 9.0)) * float(np.clip(seconds / 25.0, 0.4, 1.0))
        length = _covered(going_s, usual_m_s, speed_profile.tangential_m_s2)
        if len(parts) == 4:
            length = -0.3 * length
        pause = rest(at + length, float(rng.uniform(1.0, 3.0)) + 1.2 * ease_s)
        parts += [leg(speed_profile, at, at + length), pause]
        at += length
        elapsed += parts[-2].duration_s + parts[-1].duration_s
    return chain(parts)


def _covered(seconds: float, speed_m_s: float, accel_m_s2: float) -> float:
    """Distance from rest to rest in a given time."""
    gaining_s = min(speed_m_s / accel_m_s2, 0.5 * seconds)
    return accel_m_s2 * gaining_s * (seconds - gaining_s)


def loop_in_time(speed_profile: SpeedProfile, seconds: float, ease_s: float) -> Schedule:
    """Start from rest and end at rest after `seconds`, with as many laps as fit.

    Raises:
        ConfigError: not even one lap fits.
    """
    still_s = 0.6 * ease_s
    going_s = seconds - 2.0 * still_s
    shortest_s = leg(speed_profile, 0.0, speed_profile.length_m).duration_s
    if shortest_s > going_s:
        raise ConfigError(
            f"a loop of {speed_profile.length_m:.0f} m takes "
            f"{shortest_s + 2.0 * still_s:.1f} s or more at this speed; {seconds:g} s are too short"
        )
    laps = max(1, int(going_s / speed_profile.lap_s))
    while laps > 1 and leg(speed_profile, 0.0, laps * speed_profile.length_m).duration_s > going_s:
        laps -= 1
    end_m = laps * speed_profile.length_m
    slow, fast = end_m / going_s, float(np.sqrt(speed_profile.squared_speeds.max()))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (slow + fast)
        if leg(speed_profile.limited(middle), 0.0, end_m).duration_s > going_s:
            slow = middle
        else:
            fast = middle
    moving = leg(speed_profile.limited(fast), 0.0, end_m)
    exact = Schedule(
        moving.times_s * (going_s / moving.duration_s),
        moving.distances_m,
        moving.speeds_m_s * (moving.duration_s / going_s),
    )
    return chain([rest(0.0, still_s), exact, rest(end_m, still_s)])
