"""Two images of a textured plane or of a scene with depth, with known geometry."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.geometry.transforms import se3_exp
from vo.base.types import Bytes, Camera, Floats

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
MOTION = se3_exp(np.array([0.02, -0.04, 0.03, 0.25, -0.05, 0.1]))


def texture(seed: int, height: int = 480, width: int = 640) -> Bytes:
    """Blobs of several sizes."""
    random = np.random.default_rng(seed)
    image = np.zeros((height, width), np.float32)
    for sigma in (1.5, 3.0, 6.0):
        noise = random.standard_normal((height, width)).astype(np.float32)
        blurred = cv2.GaussianBlur(noise, (0, 0), sigma)
        image += blurred / blurred.std()
    return np.clip(128 + 40 * image, 0, 255).astype(np.uint8)


def plane_homography(depth: float, motion: Floats = MOTION) -> Floats:
    """Homography of pixels of a plane at a depth, facing the first camera."""
    normal = np.array([0.0, 0.0, 1.0])
    of_rays = motion[:3, :3] + np.outer(motion[:3, 3], normal) / depth
    return np.asarray(CAMERA.matrix @ of_rays @ np.linalg.inv(CAMERA.matrix))


def plane_pair(depth: float = 4.0) -> tuple[Bytes, Bytes]:
    """Two images of a plane."""
    first = texture(0, 240, 320)
    second = cv2.warpPerspective(first, plane_homography(depth), (320, 240))
    return first, np.asarray(second, dtype=np.uint8)


def layered_pair(motion: Floats = MOTION) -> tuple[Bytes, Bytes]:
    """Two images of planes at three depths, in bands of the first image."""
    first = texture(1, 240, 320)
    second = np.zeros_like(first)
    for depth, (top, bottom) in ((6.0, (0, 80)), (3.5, (80, 160)), (2.0, (160, 240))):
        band = np.zeros_like(first)
        band[top:bottom] = 255
        homography = plane_homography(depth, motion)
        moved = cv2.warpPerspective(first, homography, (320, 240))
        is_there = cv2.warpPerspective(band, homography, (320, 240)) > 127
        second[is_there] = moved[is_there]
    return first, second
