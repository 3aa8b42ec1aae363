"""What a camera goes through on wheels, by hand, in the air and on the spot.

Each function returns (N, 6): x, y, z in metres, yaw, pitch and roll in radians of the body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.motion.limits import Carrier
from data_synth.motion.ride import Ride
from data_synth.motion.smooth import wander
from data_synth.records import GRAVITY_M_S2
from vo.types import Floats

_STEPS_HZ = 1.8
_BOB_M, _SWAY_M = 0.018, 0.02
_LEAN_RAD_S2_M = 1.5e-3  # of a car on its springs
_BANK = 0.6  # of the lean that would fully make up for an acceleration
_FULL_TURN_S = 14.0  # once round and back
_MOST_HURRY = 3.0


@dataclass(frozen=True, eq=False)
class Manner:
    """How something is carried along a ride.

    Attributes:
        rng: random numbers of its wander.
        freedom: 0…1, how far its wander takes it off the way.
        heights_m: lowest and highest height above the ground.
        outlook: where it looks, radians to the left of ahead.
        seconds: length of the path.
        speed: of the motion, 1 as usual.
        repeats: whether its wander is back at its start after `seconds`.
    """

    rng: np.random.Generator
    freedom: float
    heights_m: tuple[float, float]
    outlook: float
    seconds: float
    speed: float
    repeats: bool

    def wander(self, ride: Ride, amplitude: float, shortest_s: float, longest_s: float) -> Floats:
        """A smooth random series (N,) within ±amplitude."""
        whole = self.seconds if self.repeats else None
        return wander(self.rng, ride.times_s, amplitude, (shortest_s, longest_s), whole)

    def look(self, ride: Ride, amplitude: float, shortest_s: float, longest_s: float) -> Floats:
        """The same for where it looks: who hurries looks about faster."""
        hurry = min(self.speed, _MOST_HURRY)
        return self.wander(ride, amplitude, shortest_s / hurry, longest_s / hurry)


def car(ride: Ride, manner: Manner) -> Floats:
    """Leans on its springs with the accelerations and shakes a little with the road."""
    shake = [manner.wander(ride, size, 0.35, 1.0) for size in (0.003, 0.002, 0.002)]
    heave, pitch, roll = (ride.stir * s for s in shake)
    pitch = pitch + ride.slope + _LEAN_RAD_S2_M * ride.smoothed(ride.ahead_m_s2, 0.4)
    roll = roll + _LEAN_RAD_S2_M * ride.smoothed(ride.left_m_s2, 0.4)
    z = ride.points[:, 2] + manner.heights_m[0] + heave
    return np.column_stack([ride.points[:, :2], z, ride.heading, pitch, roll])


def robot(ride: Ride, manner: Manner) -> Floats:
    """Stays level; small stiff wheels shake it a little."""
    shake = [manner.wander(ride, size, 0.25, 0.6) for size in (0.0006, 0.0015, 0.0015)]
    heave, pitch, roll = (ride.stir * s for s in shake)
    z = ride.points[:, 2] + manner.heights_m[0] + heave
    return np.column_stack([ride.points[:, :2], z, ride.heading, pitch + ride.slope, roll])


def handheld(ride: Ride, manner: Manner) -> Floats:
    """Bobs with the steps, looks about, trembles."""
    steps = 2.0 * np.pi * (_STEPS_HZ * ride.times_s + float(manner.rng.uniform()))
    drift = [manner.freedom * manner.wander(ride, size, 3.0, 9.0) for size in (0.05, 0.05, 0.08)]
    left = ride.stir * _SWAY_M * np.sin(0.5 * steps)
    x = ride.points[:, 0] - np.sin(ride.heading) * left + drift[0]
    y = ride.points[:, 1] + np.cos(ride.heading) * left + drift[1]
    z = ride.points[:, 2] + manner.heights_m[0] + ride.stir * _BOB_M * np.cos(steps) + drift[2]
    tremble = [manner.wander(ride, 0.002, 0.22, 0.4) for _ in range(3)]
    yaw = ride.smoothed(ride.heading, 1.8) + manner.outlook
    yaw = yaw + manner.look(ride, 0.16, 2.5, 8.0) + tremble[0]
    nod = ride.stir * 0.006 * np.sin(steps)
    pitch = np.deg2rad(-5.0) + manner.look(ride, 0.09, 2.5, 7.0) + tremble[1] + nod
    roll = manner.look(ride, 0.06, 2.0, 6.0) + tremble[2] + 0.2 * left
    return np.column_stack([x, y, z, yaw, pitch, roll])


def drone(ride: Ride, manner: Manner) -> Floats:
    """Flies at wandering heights, banks into its accelerations, turns its nose about."""
    low, high = manner.heights_m
    outdoors = high - low > 5.0
    slow, near = ((25.0, 70.0), (8.0, 20.0)) if outdoors else ((6.0, 15.0), (3.0, 8.0))
    z = ride.points[:, 2] + 0.5 * (low + high)
    z = z + manner.freedom * manner.wander(ride, 0.5 * (high - low), *slow)
    aside = manner.freedom * (1.0 if outdoors else 0.08)
    x, y = (ride.points[:, i] + manner.wander(ride, aside, *near) for i in (0, 1))
    yaw = ride.smoothed(ride.heading, 1.5) + manner.outlook + manner.look(ride, 0.35, 5.0, 12.0)
    off = yaw - ride.heading
    ahead = np.cos(off) * ride.ahead_m_s2 + np.sin(off) * ride.left_m_s2
    left = np.cos(off) * ride.left_m_s2 - np.sin(off) * ride.ahead_m_s2
    lean = _BANK / GRAVITY_M_S2
    pitch = -lean * ride.smoothed(ahead, 0.6) + manner.wander(ride, 0.012, 0.4, 1.5)
    roll = -lean * ride.smoothed(left, 0.6) + manner.wander(ride, 0.012, 0.4, 1.5)
    return np.column_stack([x, y, z, yaw, pitch, roll])


def rotate(ride: Ride, manner: Manner) -> Floats:
    """Turns once round and back, again and again, hardly moving from the spot."""
    x, y, z = (ride.points[:, i] + manner.wander(ride, 0.012, 4.0, 9.0) for i in range(3))
    rounds = max(1, int(manner.seconds * manner.speed / _FULL_TURN_S))
    period = max(manner.seconds / rounds, _FULL_TURN_S / manner.speed)
    # Easing takes something off both ends of each turn.
    ease_s = 1.5 / manner.speed
    extent = 2.0 * np.pi * (1.0 + 0.5 * ease_s / period)
    wave = np.abs((ride.times_s / period + 0.5) % 1.0 - 0.5) * 2.0
    yaw = ride.heading + extent * ride.smoothed(wave, ease_s)
    pitch = manner.wander(ride, 0.22, 4.0, 9.0)
    roll = manner.wander(ride, 0.04, 3.0, 8.0)
    return np.column_stack([x, y, z + manner.heights_m[0], yaw, pitch, roll])


CARRIERS: dict[Carrier, Callable[[Ride, Manner], Floats]] = {
    "car": car,
    "robot": robot,
    "handheld": handheld,
    "drone": drone,
    "drone_indoors": drone,
    "rotate": rotate,
}
