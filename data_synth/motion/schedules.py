"""Schedules of the motions: drive on, stop and go, loops within a duration."""

from __future__ import annotations

import numpy as np

from data_synth.motion.speed_profile import Schedule, SpeedProfile, chain, leg, rest
from vo.base.errors import ConfigError

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
