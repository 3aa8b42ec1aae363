"""Camera models: projection of points to pixels, and rays of pixels."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.distortion import (
    distort_directions,
    distort_rays,
    undistort_directions,
    undistort_rays,
)
from vo.base.types import Camera, Floats


def project(camera: Camera, points: Floats) -> Floats:
    """Pixels (N, 2) of points (N, 3) in the camera's frame.

    NaN beyond the reach of the lens model, and for points that are not in front of the camera.
    """
    depth = np.where(points[:, 2:3] > 0, points[:, 2:3], np.nan)
    return distort(camera, points[:, :2] / depth)


def project_wide(camera: Camera, directions: Floats) -> Floats:
    """Pixels (N, 2) of directions (N, 3), behind the camera too; NaN beyond the reach of the lens.

    Of `equirectangular` images all directions have a pixel.
    """
    moved = distort_directions(camera, np.asarray(directions, dtype=np.float64))
    return np.asarray(moved * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def directions(camera: Camera, pixels: Floats) -> Floats:
    """Directions (N, 3) of length 1 of pixels (N, 2); NaN where the lens has none."""
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    moved = np.asarray((pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    found = undistort_directions(camera, moved)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def distort(camera: Camera, rays: Floats) -> Floats:
    """Pixels (N, 2) of normalised image points (N, 2) (x/z, y/z).

    NaN beyond the reach of the lens model, so that a ray from far outside never falls into the
    image.
    """
    rays = np.asarray(rays, dtype=np.float64).reshape(-1, 2)
    if camera.is_distorted:
        rays = distort_rays(camera, rays)
    return np.asarray(rays * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def normalise(camera: Camera, pixels: Floats) -> Floats:
    """Normalised image points (N, 2) (x/z, y/z) of pixels (N, 2): the inverse of `distort`.

    NaN for pixels without a ray in front of the camera (the corners of a fisheye image).
    """
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    rays = np.asarray((pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    return undistort_rays(camera, rays) if camera.is_distorted else rays


def ideal_pixels(camera: Camera, pixels: Floats) -> Floats:
    """Pixels (N, 2) as a pinhole camera with the same matrix would see them; NaN without a ray."""
    return np.asarray(normalise(camera, pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def equirectangular(width: int, height: int) -> Camera:
    """The camera of images with all directions: longitudes across, latitudes from top to bottom."""
    centre = 0.5 * (width - 1), 0.5 * (height - 1)
    return Camera(width, height, width / (2 * np.pi), height / np.pi, *centre, "equirectangular")
