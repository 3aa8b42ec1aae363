"""Images of flat objects, and scenes that show them at known places."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from data_synth.worlds import prints, textures
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Bytes, Camera, Floats

CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
SHAPE = (180, 240)  # of stored images
WIDTH_M = 0.2


@cache
def stored(number: int) -> Bytes:
    """The image of an object."""
    make = (textures.poster, prints.notices, textures.poster)[number % 3]
    texture = make(np.random.default_rng((5, number)), SHAPE)
    return np.asarray(np.rint(255.0 * texture), dtype=np.uint8)


def pose(x: float, y: float, z: float, turn_deg: float = 0.0, tilt_deg: float = 0.0) -> Floats:
    """cam_from_object of an object with its centre at a place in metres."""
    rotation = so3_exp(np.array([0.0, np.deg2rad(tilt_deg), 0.0])) @ so3_exp(
        np.array([0.0, 0.0, np.deg2rad(turn_deg)])
    )
    return make_transform(rotation, np.array([x, y, z]))


def homography(cam_from_object: Floats) -> Floats:
    """Pixels of the stored image to those of the scene."""
    unit = WIDTH_M / SHAPE[1]
    columns = np.column_stack(
        [unit * cam_from_object[:3, 0], unit * cam_from_object[:3, 1], cam_from_object[:3, 3]]
    )
    to_middle = np.eye(3)
    to_middle[:2, 2] = -(SHAPE[1] - 1) / 2.0, -(SHAPE[0] - 1) / 2.0
    return np.asarray(CAMERA.matrix @ columns @ to_middle)


def corners(cam_from_object: Floats) -> Floats:
    """(4, 2) pixels of the corners of the stored image."""
    height, width = SHAPE
    at = np.array(
        [[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]]
    )
    mapped = np.column_stack([at, np.ones(4)]) @ homography(cam_from_object).T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def scene(*placed: tuple[int, Floats], seed: int = 0) -> Bytes:
    """Objects, by number, at poses, before a wall with other prints, with noise."""
    rng = np.random.default_rng((6, seed))
    canvas = 255.0 * textures.plaster(rng, (CAMERA.height, CAMERA.width))
    for _ in range(4):
        top, left = int(rng.integers(0, 400)), int(rng.integers(0, 540))
        part = canvas[top : top + 80, left : left + 100]
        part[:] = 255.0 * prints.label(rng, (80, 100))[: part.shape[0], : part.shape[1]]
    for number, cam_from_object in placed:
        matrix = homography(cam_from_object)
        size = CAMERA.width, CAMERA.height
        image = cv2.warpPerspective(stored(number).astype(np.float32), matrix, size)
        mask = cv2.warpPerspective(np.ones(SHAPE, np.float32), matrix, size)
        canvas = mask * image + (1.0 - mask) * canvas
    canvas += rng.normal(0.0, 2.0, canvas.shape)
    return np.asarray(np.clip(np.rint(canvas), 0, 255), dtype=np.uint8)
