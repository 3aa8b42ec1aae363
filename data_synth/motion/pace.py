"""When something is where along its way, within limits of speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.motion.limits import Limits
from data_synth.motion.way import Way
from vo.types import Floats

# Plans leave this share of the limits for what comes on top: easing, bumps and rounding.
_PLANNED = 0.75

_SLOWEST_M2_S2 = 1e-6


@dataclass(frozen=True, eq=False)
class Pace:
    """How fast each place of a closed way may be passed.

    Attributes:
        squares: (M,) squared speeds that no braking or speeding up is too weak for, m²/s².
        step_m: length between places.
        tangential_m_s2: acceleration along the way.
    """

    squares: Floats
    step_m: float
    tangential_m_s2: float

    @property
    def length_m(self) -> float:
        """Length of the way."""
        return len(self.squares) * self.step_m

    @property
    def lap_s(self) -> float:
        """Time of one lap without a stop."""
        return float(np.sum(self.step_m / np.sqrt(self.squares)))

    def limited(self, speed_m_s: float) -> Pace:
        """The same with a lower top speed."""
        return Pace(np.minimum(self.squares, speed_m_s**2), self.step_m, self.tangential_m_s2)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Distances along the way by time, with constant acceleration between the rows.

    Attributes:
        times_s: (N,) increasing, from 0.
        distances_m: (N,).
        speeds_m_s: (N,) negative when going back.
    """

    times_s: Floats
    distances_m: Floats
    speeds_m_s: Floats

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return float(self.times_s[-1])

    def at(self, times_s: Floats) -> Floats:
        """Distances at times; it rests before the start and after the end."""
        inside = np.clip(times_s, 0.0, self.times_s[-1])
        row = np.clip(np.searchsorted(self.times_s, inside, "right") - 1, 0, len(self.times_s) - 2)
        since = inside - self.times_s[row]
        gain = np.diff(self.speeds_m_s) / np.maximum(np.diff(self.times_s), 1e-12)
        return np.asarray(
            self.distances_m[row] + since * (self.speeds_m_s[row] + 0.5 * since * gain[row])
        )


def make_pace(way: Way, limits: Limits, speed: float) -> Pace:
    """The fastest that the way's curves and the limits allow, `speed` times the usual."""
    step = way.step_m
    places = np.arange(len(way.controls), dtype=np.float64) * step
    curvatures = np.maximum(way.curvatures(places), 1e-9)
    squares = np.minimum(
        _PLANNED * limits.lateral_m_s2 / curvatures,
        (_PLANNED * limits.turn_rad_s / curvatures) ** 2,
    )
    squares = np.clip(squares, _SLOWEST_M2_S2, (limits.speed_m_s * speed) ** 2)
    tangential = _PLANNED * limits.tangential_m_s2
    return Pace(_reachable(squares, 2.0 * tangential * step), step, tangential)


def _reachable(squares: Floats, gain: float) -> Floats:
    """The largest series below a closed one that changes by at most `gain` a step."""
    count = len(squares)
    three = np.tile(squares, 3)
    ramp = gain * np.arange(3 * count)
    rising = np.minimum.accumulate(three - ramp) + ramp
    falling = (np.minimum.accumulate((three + ramp)[::-1]))[::-1] - ramp
    return np.asarray(np.minimum(rising, falling)[count : 2 * count])


def leg(pace: Pace, start_m: float, end_m: float) -> Schedule:
    """From rest at one place to rest at another one, forwards or back."""
    low, high = sorted((start_m, end_m))
    count = 3 + int((high - low) / pace.step_m)  # a row between the ends, that has some speed
    distances = np.linspace(low, high, count)
    lap = np.append(pace.squares, pace.squares[0])
    squares = np.interp(distances % pace.length_m / pace.step_m, np.arange(len(lap)), lap)
    twice = 2.0 * pace.tangential_m_s2
    squares = np.minimum(squares, twice * np.minimum(distances - low, high - distances))
    speeds = np.sqrt(np.maximum(squares, 0.0))
    steps = 2.0 * np.diff(distances) / (speeds[1:] + speeds[:-1])
    if end_m < start_m:
        distances, speeds, steps = distances[::-1], -speeds[::-1], steps[::-1]
    return Schedule(np.concatenate([[0.0], np.cumsum(steps)]), distances, speeds)


def rest(at_m: float, seconds: float) -> Schedule:
    """Standing still."""
    return Schedule(np.array([0.0, seconds]), np.array([at_m, at_m]), np.zeros(2))


def chain(parts: list[Schedule]) -> Schedule:
    """One after the other."""
    starts = np.concatenate([[0.0], np.cumsum([part.duration_s for part in parts])])
    return Schedule(
        np.concatenate([p.times_s + s for p, s in zip(parts, starts[:-1], strict=True)]),
        np.concatenate([p.distances_m for p in parts]),
        np.concatenate([p.speeds_m_s for p in parts]),
    )
