"""Orientations of a single camera that only turns, by the gyroscope.

Without a translation one camera has no map. The rotations between a reference image and later ones
show that the camera only turns, and give the bias of the gyroscope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.geometry import so3
from vo.engine.inertial.initialisation import upright
from vo.engine.inertial.preintegration import Interval, preintegrate, rotation_of
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import GRAVITY_M_S2

_FIT_ROUNDS = 4
_MAX_RESIDUAL_PX = 2.0  # median, of a camera that only turns
_OUTLIER = 3.0  # residual in units of the median one, from which a match counts less
_MAX_TURN_S = 5.0  # between the two images of a rotation
_MIN_TURNS = 10
_MAX_DIFFERENCE_RAD = 0.01  # median, of rotations by images and by the gyroscope
_BIAS_ROUNDS = 3
_MAX_GRAVITY_ERROR = 0.1


class Turn(NamedTuple):
    """A rotation of the rectified camera between two images, if nothing but that."""

    first_ns: int  # time of the first image
    last_ns: int  # time of the second one
    last_from_first: Floats  # (3, 3)
    residual_px: float  # median residual of the matches


class TurnLog:
    """Rotations between images that make no map yet.

    Attributes:
        turns: in time order.
    """

    def __init__(self) -> None:
        self.turns: list[Turn] = []

    def add(self, times_ns: tuple[int, int], first: Floats, second: Floats, matrix: Floats) -> None:
        """Add the rotation of matched ideal pixels (n, 2) of two images; outliers count less."""
        inverted = np.asarray(np.linalg.inv(matrix), np.float64)
        rays = [_rays(xy, inverted) for xy in (first, second)]
        rotation, weight = np.eye(3), np.ones(len(first))
        residual = np.zeros(len(first))
        for _ in range(_FIT_ROUNDS):
            rotation = _rotation(rays[0], rays[1], weight)
            turned = rays[0] @ rotation.T
            seen = turned[:, 2] > 1e-3
            pixel = turned / np.where(seen, turned[:, 2], 1.0)[:, None] @ matrix.T
            residual = np.where(seen, np.linalg.norm(pixel[:, :2] - second, axis=1), np.inf)
            limit = _OUTLIER * max(median(residual), 0.1)
            weight = np.where(residual > limit, 0.0, 1.0)
        self.turns.append(Turn(*times_ns, rotation, float(median(residual))))


class Turning(NamedTuple):
    """What is known of a camera that turns."""

    gyro_bias: Floats  # (3,) rad/s
    sigma_rad_s: float  # standard deviation of the bias
    first_ns: int  # time of the first image that shows a turn
    last_ns: int  # of the last one


def turning_between(
    turns: list[Turn], times_ns: tuple[int, int], reader: SampleReader, imu_from_cam: Floats
) -> Turning | None:
    """The turns between two times; None if images and gyroscope do not confirm each other."""
    chosen = [
        turn
        for turn in turns
        if times_ns[0] <= turn.first_ns < turn.last_ns <= times_ns[1]
        and turn.residual_px < _MAX_RESIDUAL_PX
        and turn.last_ns - turn.first_ns <= _MAX_TURN_S * 1e9
    ]
    intervals = [reader.between(turn.first_ns, turn.last_ns) for turn in chosen]
    known = [n for n, interval in enumerate(intervals) if interval is not None]
    if len(known) < _MIN_TURNS:
        return None
    to_imu = imu_from_cam[:3, :3]
    seen = np.stack([to_imu @ chosen[n].last_from_first.T @ to_imu.T for n in known])
    measured = [interval for interval in intervals if interval is not None]
    bias, off = _bias(seen, measured)
    if median(np.linalg.norm(off, axis=1)) > _MAX_DIFFERENCE_RAD:
        return None
    # Rotations from one reference image have its errors in common.
    references = len({chosen[n].first_ns for n in known})
    duration = np.array([interval.duration_s for interval in measured])
    spread = np.sqrt(np.mean(off**2) / (np.mean(duration**2) * references))
    first, last = chosen[known[0]].first_ns, chosen[known[-1]].last_ns
    return Turning(bias, float(spread), first, last)


class Orientations(NamedTuple):
    """Orientations at some times, relative to the first."""

    first_from_cam: Floats  # (n, 3, 3)
    sigma_rad: Floats  # (n,) standard deviation of each, relative to the first
    # (3,) direction away from the earth in the first camera's frame, None if the forces are not
    # those of gravity
    up: Floats | None


def orientations(
    turning: Turning,
    stamps_ns: Ints,
    reader: SampleReader,
    imu_from_cam: Floats,
    noise: ImuNoise,
) -> Orientations | None:
    """Orientations of the camera at times (n,), increasing; None where samples are missing."""
    to_imu, rotation = imu_from_cam[:3, :3], [np.eye(3)]
    force, total_s = np.zeros(3), 0.0
    for begin, end in zip(stamps_ns[:-1].tolist(), stamps_ns[1:].tolist(), strict=True):
        interval = reader.between(begin, end)
        if interval is None:
            return None
        measured = preintegrate(interval, turning.gyro_bias, np.zeros(3), noise)
        # The change of velocity is that by gravity and by movements that come to nothing.
        force += rotation[-1] @ measured.velocity
        total_s += measured.duration_s
        rotation.append(rotation[-1] @ measured.rotation)
    first_from_imu = np.stack(rotation)
    elapsed_s = 1e-9 * (stamps_ns - stamps_ns[0])
    sigma = np.hypot(turning.sigma_rad_s * elapsed_s, noise.gyro_noise * np.sqrt(elapsed_s))
    up = to_imu.T @ force / max(total_s, 1e-9)
    is_gravity = abs(np.linalg.norm(up) / GRAVITY_M_S2 - 1.0) < _MAX_GRAVITY_ERROR
    return Orientations(to_imu.T @ first_from_imu @ to_imu, sigma, up if is_gravity else None)


def upright_from_first(up: Floats | None) -> Floats:
    """(3, 3) from the first camera to a world whose z axis points up, if that is known."""
    return np.eye(3) if up is None else upright(np.eye(3), -up)


def _bias(seen: Floats, measured: list[Interval]) -> tuple[Floats, Floats]:
    """Bias (3,), and the differences (n, 3) of rotations that it leaves, tangent on the right."""
    bias = np.zeros(3)
    off = np.zeros((len(measured), 3))
    for _ in range(_BIAS_ROUNDS):
        jacobian = np.stack([_by_bias(interval, bias) for interval in measured])
        turned = np.stack([rotation_of(interval, bias) for interval in measured])
        off = so3.log(np.swapaxes(turned, 1, 2) @ seen)
        size = np.linalg.norm(off, axis=1)
        weight = 1.0 / np.maximum(size, 0.5 * median(size) + 1e-9)  # towards the median
        normal = np.einsum("n,nji,njk->ik", weight, jacobian, jacobian)
        right = np.einsum("n,nji,nj->i", weight, jacobian, off)
        bias = bias + np.linalg.solve(normal, right)
    return bias, off


def _by_bias(interval: Interval, bias: Floats) -> Floats:
    """(3, 3) derivative of the rotation of an interval by the bias, tangent on its right."""
    dt = np.diff(interval.seconds)[:, None]
    steps = 0.5 * (interval.gyro[1:] + interval.gyro[:-1]) - bias
    turned = so3.running_products(so3.exp(steps * dt))
    after = np.swapaxes(turned[1:], 1, 2) @ turned[-1]  # from the end of each step to the end
    effects = np.swapaxes(after, 1, 2) @ so3.right_jacobian(steps * dt)
    return np.asarray(-(effects * dt[:, :, None]).sum(axis=0))


def _rays(xy: Floats, inverted: Floats) -> Floats:
    """Unit rays (n, 3) of pixels (n, 2)."""
    rays = np.column_stack([xy, np.ones(len(xy))]) @ inverted.T
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])


def _rotation(first: Floats, second: Floats, weight: Floats) -> Floats:
    """(3, 3) that turns rays (n, 3) to others best.

    Source: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    u, _, vt = np.linalg.svd((second * weight[:, None]).T @ first)
    flip = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    return np.asarray(u @ flip @ vt)
