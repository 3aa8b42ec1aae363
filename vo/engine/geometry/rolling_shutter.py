"""Rolling shutter: pixels as if all rows of an image had been exposed with its middle row.

Rows are read one after the other, so a moving camera sees each from another pose. With a velocity
that is constant during the readout, the pose at a time t after that of the middle row is
middle_from_row = exp(t (angular, linear)), and a point at normalised pixel x with inverse depth w
moves as the homogeneous point (x, 1, w). To first order in t this is the image Jacobian of visual
servoing (Chaumette and Hutchinson, "Visual servo control, part I", 2006, eq. 11).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Floats

_ROUNDS = 2  # to find the row in which a point is seen; each leaves a tenth of the error or less
_SMALL = 1e-3  # radians below which series are used


class Velocity(NamedTuple):
    """Velocity of the rectified left camera, in its own frame.

    Attributes:
        angular: (3,) rad/s.
        linear: (3,) per second, in units of the map.
    """

    angular: Floats
    linear: Floats


class _Motion(NamedTuple):
    """How rays (x, y, 1) move from one time to another, as turned + inverse_depth * shift.

    Attributes:
        turned: (N, 3).
        shift: (N, 3).
    """

    turned: Floats
    shift: Floats


def row_times(rig: RectifiedRig, image_xy: Floats, side: int = 0) -> Floats:
    """Seconds (N,) from the middle row of the recorded image to the rows of pixels (N, 2).

    Args:
        rig: the rectified cameras.
        image_xy: pixels of the rectified image.
        side: 0 for the left camera, 1 for the right one.
    """
    maps, last = rig.maps[side], rig.recorded_rows - 1
    row = image_xy[:, 1]
    if maps is not None:  # its pixel of the recorded image, to the next whole row
        row = _recorded_rows(maps[0], np.ascontiguousarray(image_xy))
    return np.asarray(rig.readout_s * (row.clip(0.0, last) / last - 0.5))


def at_middle_row(
    rig: RectifiedRig, image_xy: Floats, inverse_depth: Floats | float, velocity: Velocity | None
) -> Floats:
    """Undistorted pixels (N, 2) at the time of the middle row.

    Args:
        rig: the rectified cameras.
        image_xy: (N, 2) pixels of the rectified image.
        inverse_depth: (N,) at that time, 0 where only the rotation is to be corrected.
        velocity: of the camera; None to undistort the pixels only.
    """
    xy = rig.undistort(image_xy)
    if velocity is None:
        return xy
    turned, shift = _motion(rig, xy, row_times(rig, image_xy), velocity)
    # The inverse depth at the time of the row is inverse_depth * turned_z / ratio.
    ratio = 1.0 - inverse_depth * shift[:, 2]
    rays = turned[:, :2] * (ratio / turned[:, 2])[:, None]
    return _pixels(rig, rays + shift[:, :2] * np.reshape(inverse_depth, (-1, 1)))


def as_seen(
    rig: RectifiedRig, xy: Floats, inverse_depth: Floats, velocity: Velocity | None
) -> Floats:
    """Pixels (N, 2) of the rectified image, in the row in which they are read.

    Args:
        rig: the rectified cameras.
        xy: (N, 2) undistorted pixels at the time of the middle row.
        inverse_depth: (N,) at that time.
        velocity: of the camera; None to distort the pixels only.
    """
    image_xy = rig.distort(xy)
    if velocity is None:
        return image_xy
    for _ in range(_ROUNDS):
        seconds = row_times(rig, np.nan_to_num(image_xy))
        turned, shift = _motion(rig, xy, -seconds, velocity)
        ray = turned + shift * inverse_depth[:, None]
        image_xy = rig.distort(_pixels(rig, ray[:, :2] / ray[:, 2:]))
    return image_xy


def disparity_at_middle_row(
    rig: RectifiedRig, image_xy: Floats, disparity: Floats, velocity: Velocity
) -> Floats:
    """Disparities (N,) at the time of the middle row.

    Both cameras begin to read at the same time, but a row of the rectified pair may be another one
    in each recorded image.

    Args:
        rig: the rectified cameras, or one with depth.
        image_xy: (N, 2) pixels of the left image.
        disparity: (N,) as measured, NaN where unknown.
        velocity: of the left camera.
    """
    near = disparity / (rig.fx * rig.baseline_m)
    turned, shift = _motion(rig, rig.undistort(image_xy), row_times(rig, image_xy), velocity)
    left = turned + shift * near[:, None]
    if rig.maps[1] is None:
        return np.asarray(disparity / left[:, 2])
    right_xy = np.column_stack([image_xy[:, 0] - np.nan_to_num(disparity), image_xy[:, 1]])
    arm = np.array([rig.baseline_m, 0.0, 0.0])
    of_right = Velocity(velocity.angular, velocity.linear + np.cross(velocity.angular, arm))
    turned, shift = _motion(rig, right_xy, row_times(rig, right_xy, 1), of_right)
    right = turned + shift * near[:, None]
    return np.asarray(rig.fx * (left[:, 0] / left[:, 2] - right[:, 0] / right[:, 2]))


def _motion(rig: RectifiedRig, xy: Floats, seconds: Floats, velocity: Velocity) -> _Motion:
    """Motion of the rays of undistorted pixels (N, 2) by exp(seconds (angular, linear)), (N,)."""
    rays = (xy - (rig.cx, rig.cy)) / (rig.fx, rig.fy)
    return moved_rays(np.ascontiguousarray(rays), np.ascontiguousarray(seconds), velocity)


def moved_rays(rays: Floats, seconds: Floats, velocity: Velocity) -> _Motion:
    """Motion of rays (N, 2), with z = 1, by exp(seconds (angular, linear)) with times (N,)."""
    angular, linear = (np.ascontiguousarray(part) for part in velocity)
    return _Motion(*_moved(rays, seconds, angular, linear))


def _pixels(rig: RectifiedRig, rays: Floats) -> Floats:
    return np.asarray(rays * (rig.fx, rig.fy) + (rig.cx, rig.cy))


@compiled
def _recorded_rows(pixels, xy):  # type: ignore[no-untyped-def]
    """Rows (N,) of the recorded image at pixels (N, 2) of the rectified one, or at its edge."""
    height, width, _ = pixels.shape
    rows = np.empty(len(xy))
    for n in range(len(xy)):
        u = min(max(xy[n, 0], 0.0), width - 1.0)
        v = min(max(xy[n, 1], 0.0), height - 1.0)
        rows[n] = pixels[int(v + 0.5), int(u + 0.5), 1]
    return rows


@compiled
def _moved(rays, seconds, angular, linear):  # type: ignore[no-untyped-def]
    """R (x, y, 1) and V v t of each ray, with R and V of Barfoot 2017, eq. 7.23 and 7.37."""
    turned, shift = np.empty((len(rays), 3)), np.empty((len(rays), 3))
    speed = np.sqrt(angular[0] ** 2 + angular[1] ** 2 + angular[2] ** 2)
    for n in range(len(rays)):
        t = seconds[n]
        angle = abs(t) * speed
        squared = angle * angle
        if angle < _SMALL:
            a, b, c = 1.0 - squared / 6.0, 0.5 - squared / 24.0, 1.0 / 6.0 - squared / 120.0
        else:
            a, half = np.sin(angle) / angle, np.sin(0.5 * angle) / angle
            b, c = 2.0 * half * half, (1.0 - a) / squared
        x, y, z = t * angular[0], t * angular[1], t * angular[2]
        p, q = rays[n, 0], rays[n, 1]
        # The rotation vector times the ray, and times that.
        i, j, k = y - z * q, z * p - x, x * q - y * p
        turned[n, 0] = p + a * i + b * (y * k - z * j)
        turned[n, 1] = q + a * j + b * (z * i - x * k)
        turned[n, 2] = 1.0 + a * k + b * (x * j - y * i)
        p, q, r = t * linear[0], t * linear[1], t * linear[2]
        i, j, k = y * r - z * q, z * p - x * r, x * q - y * p
        shift[n, 0] = p + b * i + c * (y * k - z * j)
        shift[n, 1] = q + b * j + c * (z * i - x * k)
        shift[n, 2] = r + b * k + c * (x * j - y * i)
    return turned, shift
