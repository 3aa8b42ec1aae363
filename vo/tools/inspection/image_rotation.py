"""Rotations of a camera between consecutive images, where a gyroscope shows that they change."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.cameras import ideal_pixels
from vo.base.geometry.transforms import skew, so3_exp, so3_log
from vo.base.types import Bytes, Camera, Floats, Ints
from vo.engine.frontend.optical_flow import follow
from vo.engine.geometry.epipolar import find_essential, recover_motion
from vo.engine.geometry.gyro_alignment import Rotations

_WINDOWS, _IMAGES = 12, 9
"""Number of windows over the recording, and of consecutive images in each."""

_INTERVAL_S = 0.1
_MAX_STEP_S = 0.2
_CORNERS = 250
_QUALITY, _DISTANCE_PX = 0.005, 12
_THRESHOLD_PX = 1.0
_MIN_POINTS = 30
_MIN_INLIERS = 0.5
_STEPS = 6


class _Points(NamedTuple):
    """Rays (N, 3) of the same points in two images, with z 1."""

    first: Floats
    second: Floats


def measure_rotations(
    read: Callable[[int], Bytes | None],
    stamps_ns: Ints,
    camera: Camera,
    gyro_ns: Ints,
    gyro: Floats,
) -> Rotations:
    """Rotations between consecutive images in some windows.

    `read`: reads an image by number, None if it is unreadable. `stamps_ns`: (N,) stamps of all
    images. `gyro_ns`: (M,) stamps of the gyroscope. `gyro`: (M, 3) rad/s; used only to choose
    images.
    """
    found: list[tuple[int, int, Floats]] = []
    step = _step(stamps_ns)
    for window in choose_windows(stamps_ns, gyro_ns, gyro):
        images = {number: read(number) for number in window}
        for number in window[:-step]:
            before, after = images[number], images[number + step]
            rotvec = None
            if before is not None and after is not None:
                rotvec = rotation_between(before, after, camera)
            if rotvec is not None:
                found.append((int(stamps_ns[number]), int(stamps_ns[number + step]), rotvec))
    return Rotations(
        np.array([row[0] for row in found], dtype=np.int64),
        np.array([row[1] for row in found], dtype=np.int64),
        np.array([row[2] for row in found]).reshape(-1, 3),
    )


def _step(stamps_ns: Ints) -> int:
    """Images apart: rotations over a longer time show more of the change of the rate."""
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9 if len(stamps_ns) > 1 else 1.0
    return int(np.clip(round(_INTERVAL_S / interval_s), 1, _IMAGES // 2))


def choose_windows(stamps_ns: Ints, gyro_ns: Ints, gyro: Floats) -> list[range]:
    """Numbers of consecutive images, in each part of the recording where the rate changes most."""
    if len(stamps_ns) < 2 or len(gyro_ns) < 2:
        return []
    times = (stamps_ns - gyro_ns[0]) / 1e9
    rate = [np.interp(times, (gyro_ns - gyro_ns[0]) / 1e9, axis) for axis in gyro.T]
    change = np.linalg.norm(np.diff(np.stack(rate, axis=1), axis=0), axis=1)
    change[np.diff(stamps_ns) > _MAX_STEP_S * 1e9] = 0.0
    length = min(_IMAGES, len(stamps_ns)) - 1
    total = np.convolve(change, np.ones(length), mode="valid")
    windows: list[range] = []
    for part in np.array_split(np.arange(len(total)), _WINDOWS):
        if len(part):
            first = int(part[np.argmax(total[part])])
            if not windows or first >= windows[-1].stop - 1:
                windows.append(range(first, first + length + 1))
    return windows


def rotation_between(before: Bytes, after: Bytes, camera: Camera) -> Floats | None:
    """Rotation vector of first_from_last between two images; None if it is not certain."""
    corners = cv2.goodFeaturesToTrack(before, _CORNERS, _QUALITY, _DISTANCE_PX)
    if corners is None:
        return None
    xy = corners.reshape(-1, 2)
    flow = follow(before, after, xy, xy)
    first = ideal_pixels(camera, xy[flow.found].astype(np.float64))
    second = ideal_pixels(camera, flow.xy[flow.found])
    finite = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    first, second = first[finite], second[finite]
    if len(first) < _MIN_POINTS:
        return None
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    essential = find_essential(first, second, matrix, _THRESHOLD_PX)
    if essential is None or essential[1].sum() < max(_MIN_POINTS, _MIN_INLIERS * len(first)):
        return None
    motion = recover_motion(essential[0], first, second, matrix, essential[1])
    inverse = np.linalg.inv(matrix)
    points = _Points(
        *(np.column_stack([xy, np.ones(len(xy))]) @ inverse.T for xy in (first, second))
    )
    rotation = _refined(motion, points, _THRESHOLD_PX / camera.fx)
    return so3_log(rotation.T)


def _refined(second_from_first: Floats, points: _Points, scale: float) -> Floats:
    """The rotation with the least robust Sampson errors; translation of unit length.

    Source: Hartley and Zisserman, "Multiple View Geometry", 2004, equation 11.9.
    """
    rotation, direction = second_from_first[:3, :3], second_from_first[:3, 3]
    for _ in range(_STEPS):
        side = np.linalg.svd(direction[None])[2][1:]  # two directions across
        turned = points.first @ rotation.T
        essential = skew(direction) @ rotation
        line_b, line_a = points.first @ essential.T, points.second @ essential
        norm = np.sqrt((line_b[:, :2] ** 2).sum(axis=1) + (line_a[:, :2] ** 2).sum(axis=1))
        error = (points.second * line_b).sum(axis=1) / norm
        # d(b . t x exp(w) R a) = w . (R a x (b x t)) and dt . (R a x b)
        by_turn = np.cross(turned, np.cross(points.second, direction)) / norm[:, None]
        by_direction = np.cross(turned, points.second) @ side.T / norm[:, None]
        jacobian = np.hstack([by_turn, by_direction])
        weight = 1.0 / (1.0 + (error / scale) ** 2) ** 2
        information = (jacobian * weight[:, None]).T @ jacobian
        gradient = jacobian.T @ (weight * error)
        step = -np.linalg.pinv(information, rcond=1e-9, hermitian=True) @ gradient
        rotation = so3_exp(step[:3]) @ rotation
        direction = direction + side.T @ step[3:]
        direction /= np.linalg.norm(direction)
    return np.asarray(rotation)
