"""Rectification maps: where in the recorded image the pixels of a rectified one lie."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.geometry import cameras
from vo.base.geometry.lens_field import reach
from vo.base.types import Camera, Floats, Floats32

Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]
"""OpenCV's fixed-point maps: whole pixels (H, W, 2), and fractions of pixels (H, W)."""

# A pixel outside of every image, for rays that a lens does not see; OpenCV's maps have 16 bits.
_OUTSIDE_PX = -10000.0
# Maximum distance of neighbours in a map, unless one of them is outside of the image.
_TORN_PX = 100.0


def narrow_maps(
    camera: Camera, rotation: Floats, projection: Floats, size: tuple[int, int]
) -> Maps:
    """Maps (width, height) of a `radtan` lens whose axis is near the rectified one.

    Args:
        camera: the recorded camera.
        rotation: (3, 3) rectified_from_cam.
        projection: (3, 3) matrix of the rectified camera, or (3, 4).
        size: width and height of the rectified image.
    """
    coefficients = np.array(camera.distortion, dtype=np.float64)
    first, second = cv2.initUndistortRectifyMap(
        camera.matrix, coefficients, rotation, projection[:, :3].copy(), size, cv2.CV_16SC2
    )
    return first, second


def wide_maps(camera: Camera, rotation: Floats, projection: Floats, size: tuple[int, int]) -> Maps:
    """Maps of any lens, outside of its image for rays that it does not see; as `narrow_maps`."""
    v, u = np.mgrid[: size[1], : size[0]].astype(np.float64)
    pixels = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    rays = pixels @ np.linalg.inv(projection[:, :3]).T @ rotation
    xy = cameras.project(camera, rays)
    behind = rays[:, 2] <= 0.0
    if behind.any():  # as far as its edges or usual lenses: corners are often black
        most = np.cos(reach(camera))
        behind &= rays[:, 2] >= most * np.linalg.norm(rays, axis=1)
        xy[behind] = cameras.project_wide(camera, rays[behind])
    xy = np.nan_to_num(xy, nan=_OUTSIDE_PX)
    bounded = np.clip(xy, _OUTSIDE_PX, -_OUTSIDE_PX).astype(np.float32)
    first, second = cv2.convertMaps(bounded.reshape(size[1], size[0], 2), None, cv2.CV_16SC2)
    return first, second


def displaced_maps(maps: Maps | None, u: Floats32, v: Floats32) -> Maps:
    """Maps that take each pixel from where `maps` have the position (u, v), each (H, W)."""
    if maps is not None:
        recorded = cv2.convertMaps(*maps, cv2.CV_32FC1)
        u, v = (_interpolated(side, u, v) for side in recorded)
    first, second = cv2.convertMaps(u, v, cv2.CV_16SC2)
    return first, second


def _interpolated(values: Floats32, u: Floats32, v: Floats32) -> Floats32:
    """Values of a map at positions between its pixels; `_OUTSIDE_PX` where it has none."""

    def remapped(interpolation: int) -> Floats32:
        found = cv2.remap(values, u, v, interpolation, None, cv2.BORDER_CONSTANT, _OUTSIDE_PX)
        return np.asarray(found, dtype=np.float32)

    between, nearest = remapped(cv2.INTER_LINEAR), remapped(cv2.INTER_NEAREST)
    np.subtract(between, nearest, out=nearest)
    np.copyto(between, _OUTSIDE_PX, where=np.abs(nearest, out=nearest) > _TORN_PX)
    return between
