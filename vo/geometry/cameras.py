"""Camera models: from rays to pixels and back, and what makes two cameras one rectified pair."""

from __future__ import annotations

import cv2
import numpy as np

from vo.types import Camera, Floats


def project(camera: Camera, points: Floats) -> Floats:
    """Pixels (N, 2) of points (N, 3) in the camera's frame, with distortion; z must be positive."""
    rays = np.ascontiguousarray(points[:, :2] / points[:, 2:3], dtype=np.float64)
    return distort(camera, rays)


def distort(camera: Camera, rays: Floats) -> Floats:
    """Pixels (N, 2) of normalised image points (N, 2) (x/z, y/z)."""
    if len(rays) == 0:
        return np.empty((0, 2))
    if not camera.is_distorted:
        return np.asarray(rays * (camera.fx, camera.fy) + (camera.cx, camera.cy))
    coefficients = np.array(camera.distortion, dtype=np.float64)
    if camera.distortion_model == "equidistant":
        pixels = cv2.fisheye.distortPoints(rays.reshape(-1, 1, 2), camera.matrix, coefficients)
    else:
        points = np.column_stack([rays, np.ones(len(rays))])
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, coefficients)
    return np.asarray(pixels.reshape(-1, 2), dtype=np.float64)


def normalise(camera: Camera, pixels: Floats) -> Floats:
    """Normalised image points (N, 2) (x/z, y/z) of pixels (N, 2): the inverse of `distort`."""
    pixels = np.asarray(pixels, dtype=np.float64)
    if len(pixels) == 0:
        return np.empty((0, 2))
    if not camera.is_distorted:
        return np.asarray((pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    coefficients = np.array(camera.distortion, dtype=np.float64)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
    shaped = np.ascontiguousarray(pixels.reshape(-1, 1, 2))
    if camera.distortion_model == "equidistant":
        rays = cv2.fisheye.undistortPoints(shaped, camera.matrix, coefficients, criteria=stop)
    else:
        rays = cv2.undistortPoints(shaped, camera.matrix, coefficients, criteria=stop)
    return np.asarray(rays.reshape(-1, 2), dtype=np.float64)


def undistort_pixels(camera: Camera, pixels: Floats) -> Floats:
    """Pixels (N, 2) of the ideal pinhole camera with the same matrix, for distorted (N, 2)."""
    return np.asarray(normalise(camera, pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy))
