"""What a motion does with its pace: drive on, stop now and then, come round in time."""

from __future__ import annotations

import numpy as np

from data_synth.motion.pace import Pace, Schedule, chain, leg, rest
from vo.errors import ConfigError

# Paths are asked a little after their end, and smoothing looks ahead.
_BEYOND_S = 6.0

_HALVINGS = 40


def drive_on(pace: Pace, seconds: float) -> Schedule:
    """Start from rest and go on until after the end."""
    top_m_s = float(np.sqrt(pace.squares.max()))
    braking_m = top_m_s**2 / (2.0 * pace.tangential_m_s2)
    laps = (seconds + _BEYOND_S) / pace.lap_s
    return leg(pace, 0.0, laps * pace.length_m + braking_m)


def stop_and_go(pace: Pace, seconds: float, ease_s: float, rng: np.random.Generator) -> Schedule:
    """Go and stand still by turns, and back a bit after the second stop."""
    usual_m_s = pace.length_m / pace.lap_s
    parts: list[Schedule] = []
    at, elapsed = 0.0, 0.0
    while elapsed < seconds + _BEYOND_S:
        going_s = float(rng.uniform(4.0, 9.0)) * float(np.clip(seconds / 25.0, 0.4, 1.0))
        length = _covered(going_s, usual_m_s, pace.tangential_m_s2)
        if len(parts) == 4:
            length = -0.3 * length
        pause = rest(at + length, float(rng.uniform(1.0, 3.0)) + 1.2 * ease_s)
        parts += [leg(pace, at, at + length), pause]
        at += length
        elapsed += parts[-2].duration_s + parts[-1].duration_s
    return chain(parts)


def _covered(seconds: float, speed_m_s: float, accel_m_s2: float) -> float:
    """Distance from rest to rest in a given time."""
    gaining_s = min(speed_m_s / accel_m_s2, 0.5 * seconds)
    return accel_m_s2 * gaining_s * (seconds - gaining_s)


def come_round(pace: Pace, seconds: float, ease_s: float) -> Schedule:
    """Start from rest and be back at rest after `seconds`, as many laps as fit.

    Raises:
        ConfigError: not even one fits.
    """
    still_s = 0.6 * ease_s
    going_s = seconds - 2.0 * still_s
    shortest_s = leg(pace, 0.0, pace.length_m).duration_s
    if shortest_s > going_s:
        raise ConfigError(
            f"a loop of {pace.length_m:.0f} m takes {shortest_s + 2.0 * still_s:.1f} s or more at "
            f"this speed; {seconds:g} s are too few"
        )
    laps = max(1, int(going_s / pace.lap_s))
    while laps > 1 and leg(pace, 0.0, laps * pace.length_m).duration_s > going_s:
        laps -= 1
    end_m = laps * pace.length_m
    slow, fast = end_m / going_s, float(np.sqrt(pace.squares.max()))
    for _ in range(_HALVINGS):
        middle = 0.5 * (slow + fast)
        if leg(pace.limited(middle), 0.0, end_m).duration_s > going_s:
            slow = middle
        else:
            fast = middle
    moving = leg(pace.limited(fast), 0.0, end_m)
    exact = Schedule(
        moving.times_s * (going_s / moving.duration_s),
        moving.distances_m,
        moving.speeds_m_s * (moving.duration_s / going_s),
    )
    return chain([rest(0.0, still_s), exact, rest(end_m, still_s)])
