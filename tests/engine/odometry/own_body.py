"""The robot's own body, drawn over the lower part of both images of a pair."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from vo.base.types import Bytes, Frame

SHARE = 0.3  # of the image's height
_DISPARITY_PX = 40  # of the body


def with_body(frame: Frame) -> Frame:
    """A frame with a strongly textured body."""
    images: list[Bytes | None] = []
    for camera, image in enumerate(frame.images):
        assert image is not None
        top = first_row(len(image))
        left = camera * _DISPARITY_PX
        covered = image.copy()
        covered[top:] = _body(image.shape)[top:, left : left + image.shape[1]]
        images.append(covered)
    return replace(frame, images=tuple(images))


def first_row(height: int) -> int:
    """The first row of the body in an image of some height."""
    return round(height * (1 - SHARE))


def _body(shape: tuple[int, ...]) -> Bytes:
    rng = np.random.default_rng(3)
    height, width = shape[0], shape[1] + _DISPARITY_PX
    texture = np.full((height, width), 90.0, np.float32)
    for scale, contrast in ((2, 18), (6, 45), (24, 60)):
        noise = rng.normal(0, contrast, (height // scale + 2, width // scale + 2))
        texture += cv2.resize(noise.astype(np.float32), (width, height))
    return np.clip(texture, 5, 250).astype(np.uint8)
