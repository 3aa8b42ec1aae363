"""Motion of a camera on wheels, by hand, in the air and on the spot.

Each function returns (N, 6): x, y, z in metres, yaw, pitch and roll in radians of the body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.motion.limits import Carrier
from data_synth.motion.motion_profile import MotionProfile
from data_synth.motion.route import wander
from data_synth.records import GRAVITY_M_S2
from vo.base.types import Floats

_STEPS_HZ = 1.8
_BOB_M, _SWAY_M = 0.018, 0.02
_LEAN_RAD_S2_M = 1.5e-3  # of a car on its springs
_BANK = 0.6  # of the lean that would fully compensate an acceleration
_FULL_TURN_S = 14.0  # once round and back
_MAX_LOOK_SPEED = 3.0


@dataclass(frozen=True, eq=False)
class Handling:
    """Parameters of the motion of a camera that a carrier moves along a route."""

    rng: np.random.Generator  # random numbers of the wander
    freedom: float  # 0…1, scale of the wander off the route
    heights_m: tuple[float, float]  # lowest and highest height above the ground
    view_yaw: float  # direction of view, radians to the left of ahead
    seconds: float
    speed: float  # of the motion, 1 is usual
    repeats: bool  # whether the wander is periodic in `seconds`

    def wander(
        self, profile: MotionProfile, amplitude: float, shortest_s: float, longest_s: float
    ) -> Floats:
        """A smooth random series (N,) within ±amplitude."""
        whole = self.seconds if self.repeats else None
        return wander(self.rng, profile.times_s, amplitude, (shortest_s, longest_s), whole)

    def look(
        self, profile: MotionProfile, amplitude: float, shortest_s: float, longest_s: float
    ) -> Floats:
        """The same for the direction of view, which changes faster at higher speed."""
        factor = min(self.speed, _MAX_LOOK_SPEED)
        return self.wander(profile, amplitude, shortest_s / factor, longest_s / factor)


def car(profile: MotionProfile, handling: Handling) -> Floats:
    """Lean on the springs with the accelerations, and shake slightly with the road."""
    shake = [handling.wander(profile, size, 0.35, 1.0) for size in (0.003, 0.002, 0.002)]
    heave, pitch, roll = (profile.relative_speed * s for s in shake)
    pitch = pitch + profile.slope + _LEAN_RAD_S2_M * profile.smoothed(profile.ahead_m_s2, 0.4)
    roll = roll + _LEAN_RAD_S2_M * profile.smoothed(profile.left_m_s2, 0.4)
    z = profile.points[:, 2] + handling.heights_m[0] + heave
    return np.column_stack([profile.points[:, :2], z, profile.heading, pitch, roll])


def robot(profile: MotionProfile, handling: Handling) -> Floats:
    """Stay level; small stiff wheels shake the camera slightly."""
    shake = [handling.wander(profile, size, 0.25, 0.6) for size in (0.0006, 0.0015, 0.0015)]
    heave, pitch, roll = (profile.relative_speed * s for s in shake)
    z = profile.points[:, 2] + handling.heights_m[0] + heave
    return np.column_stack([profile.points[:, :2], z, profile.heading, pitch + profile.slope, roll])


def handheld(profile: MotionProfile, handling: Handling) -> Floats:
    """Bob with the steps, look about, tremble."""
    steps = 2.0 * np.pi * (_STEPS_HZ * profile.times_s + float(handling.rng.uniform()))
    drift = [
        handling.freedom * handling.wander(profile, size, 3.0, 9.0) for size in (0.05, 0.05, 0.08)
    ]
    left = profile.relative_speed * _SWAY_M * np.sin(0.5 * steps)
    x = profile.points[:, 0] - np.sin(profile.heading) * left + drift[0]
    y = profile.points[:, 1] + np.cos(profile.heading) * left + drift[1]
    z = (
        profile.points[:, 2]
        + handling.heights_m[0]
        + profile.relative_speed * _BOB_M * np.cos(steps)
        + drift[2]
    )
    tremble = [handling.wander(profile, 0.002, 0.22, 0.4) for _ in range(3)]
    yaw = profile.smoothed(profile.heading, 1.8) + handling.view_yaw
    yaw = yaw + handling.look(profile, 0.16, 2.5, 8.0) + tremble[0]
    nod = profile.relative_speed * 0.006 * np.sin(steps)
    pitch = np.deg2rad(-5.0) + handling.look(profile, 0.09, 2.5, 7.0) + tremble[1] + nod
    roll = handling.look(profile, 0.06, 2.0, 6.0) + tremble[2] + 0.2 * left
    return np.column_stack([x, y, z, yaw, pitch, roll])


def drone(profile: MotionProfile, handling: Handling) -> Floats:
    """Fly at varying heights, bank into the accelerations, turn the nose about."""
    low, high = handling.heights_m
    outdoors = high - low > 5.0
    slow, near = ((25.0, 70.0), (8.0, 20.0)) if outdoors else ((6.0, 15.0), (3.0, 8.0))
    z = profile.points[:, 2] + 0.5 * (low + high)
    z = z + handling.freedom * handling.wander(profile, 0.5 * (high - low), *slow)
    aside = handling.freedom * (1.0 if outdoors else 0.08)
    x, y = (profile.points[:, i] + handling.wander(profile, aside, *near) for i in (0, 1))
    yaw = (
        profile.smoothed(profile.heading, 1.5)
        + handling.view_yaw
        + handling.look(profile, 0.35, 5.0, 12.0)
    )
    off = yaw - profile.heading
    ahead = np.cos(off) * profile.ahead_m_s2 + np.sin(off) * profile.left_m_s2
    left = np.cos(off) * profile.left_m_s2 - np.sin(off) * profile.ahead_m_s2
    lean = _BANK / GRAVITY_M_S2
    pitch = -lean * profile.smoothed(ahead, 0.6) + handling.wander(profile, 0.012, 0.4, 1.5)
    roll = -lean * profile.smoothed(left, 0.6) + handling.wander(profile, 0.012, 0.4, 1.5)
    return np.column_stack([x, y, z, yaw, pitch, roll])


def rotate(profile: MotionProfile, handling: Handling) -> Floats:
    """Turn once round and back, again and again, hardly moving from the spot."""
    x, y, z = (profile.points[:, i] + handling.wander(profile, 0.012, 4.0, 9.0) for i in range(3))
    rounds = max(1, int(handling.seconds * handling.speed / _FULL_TURN_S))
    period = max(handling.seconds / rounds, _FULL_TURN_S / handling.speed)
    # Easing shortens both ends of each turn.
    ease_s = 1.5 / handling.speed
    extent = 2.0 * np.pi * (1.0 + 0.5 * ease_s / period)
    wave = np.abs((profile.times_s / period + 0.5) % 1.0 - 0.5) * 2.0
    yaw = profile.heading + extent * profile.smoothed(wave, ease_s)
    pitch = handling.wander(profile, 0.22, 4.0, 9.0)
    roll = handling.wander(profile, 0.04, 3.0, 8.0)
    return np.column_stack([x, y, z + handling.heights_m[0], yaw, pitch, roll])


CARRIERS: dict[Carrier, Callable[[MotionProfile, Handling], Floats]] = {
    "car": car,
    "robot": robot,
    "handheld": handheld,
    "drone": drone,
    "drone_indoors": drone,
    "rotate": rotate,
}
