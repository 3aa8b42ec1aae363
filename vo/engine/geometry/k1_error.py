"""Effect of an error of the first radial distortion coefficient, k1, on pixels."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Floats

_STEP = 1e-6  # of k1, for derivatives
_GRID = 24  # points along each side of the image


def edge_shift_px(rig: RectifiedRig, k1: float) -> float:
    """Maximum displacement of pixels at the image's edges by an increase of k1, outwards."""
    undistorted = rig.undistort(_grid(rig))
    distorted = rig.with_k1_error(rig.k1_error + _STEP).distort(undistorted)
    moved = np.linalg.norm(distorted - rig.distort(undistorted), axis=1)
    return float(k1 / _STEP * np.nanmax(moved))


def residual_per_k1(rig: RectifiedRig) -> float:
    """Radial residual b of undistorted points, x (1 - b r^2), per increase of k1.

    1 for a lens without distortion. Undistorting the image of a lens that is compressed at the
    edges magnifies errors there: 1.8 for k1 = -0.28 at 90 degrees.
    """
    xy = _grid(rig)
    undistorted = rig.undistort(xy)
    moved = rig.with_k1_error(rig.k1_error + _STEP).undistort(xy) - undistorted
    ray = (undistorted - (rig.cx, rig.cy)) / (rig.fx, rig.fy)
    cubic = ray * np.sum(ray**2, axis=1, keepdims=True) * (rig.fx, rig.fy)
    return float(-np.nansum(moved * cubic) / np.nansum(cubic**2) / _STEP)


def corner_radius(rig: RectifiedRig) -> float:
    """Distance of the farthest image corner from the principal point, in focal lengths."""
    x = max(rig.cx, rig.width - rig.cx) / rig.fx
    y = max(rig.cy, rig.height - rig.cy) / rig.fy
    return float(np.hypot(x, y))


def _grid(rig: RectifiedRig) -> Floats:
    u, v = np.meshgrid(np.linspace(0, rig.width - 1, _GRID), np.linspace(0, rig.height - 1, _GRID))
    return np.column_stack([u.ravel(), v.ravel()])
