"""Resizing of images and calibrations."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import cv2
import numpy as np

from data_synth.cameras import with_cameras
from data_synth.records import Pixels
from vo.base.types import Camera, Floats32, Rig

Size = tuple[int, int] | float
"""Width and height of all images, or a factor."""


def scaled_camera(camera: Camera, width: int, height: int) -> Camera:
    """The camera at another image size; the outer corners of the image are kept."""
    su, sv = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=su * camera.fx,
        fy=sv * camera.fy,
        cx=su * (camera.cx + 0.5) - 0.5,
        cy=sv * (camera.cy + 0.5) - 0.5,
    )


def scaled_rig(rig: Rig, size: Size | None) -> Rig:
    """The rig with all cameras scaled."""
    if size is None:
        return rig
    return with_cameras(rig, [_scaled_to(camera, size) for camera in rig.cameras])


def _scaled_to(camera: Camera, size: Size) -> Camera:
    if isinstance(size, tuple):
        return scaled_camera(camera, *size)
    width, height = max(1, round(size * camera.width)), max(1, round(size * camera.height))
    return scaled_camera(camera, width, height)


def resized(image: Pixels, camera: Camera) -> Pixels:
    """An image, grey or colour, resized to the image size of a camera."""
    size = (camera.width, camera.height)
    if (image.shape[1], image.shape[0]) == size:
        return image
    shrinks = size[0] <= image.shape[1] and size[1] <= image.shape[0]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return cast("Pixels", cv2.resize(image, size, interpolation=method))


def resized_depth(depth: Floats32, camera: Camera) -> Floats32:
    """A depth image, resized without mixing depths at edges."""
    size = (camera.width, camera.height)
    if (depth.shape[1], depth.shape[0]) == size:
        return depth
    nearest = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    return np.asarray(nearest, dtype=np.float32)
