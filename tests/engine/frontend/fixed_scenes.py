"""Images of scenes that move, and of what does not move with them."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from vo.base.types import Bytes, Floats32
from vo.engine.frontend.camera_alignment import half_size_pyramid
from vo.engine.frontend.image_fixed import ImageFixed, ImageFixedDetector
from vo.engine.frontend.pair_matching import PairPoints

SHAPE = 240, 360
WIDE = 1400  # of the scene that images are cut from


def texture(seed: int, width: int = WIDE) -> Floats32:
    """A textured surface with flat parts."""
    rng = np.random.default_rng(seed)
    result = np.full((SHAPE[0], width), 110.0, np.float32)
    for scale, contrast in ((2, 15), (6, 30), (24, 30)):
        noise = rng.normal(0, contrast, (SHAPE[0] // scale + 2, width // scale + 2))
        result += cv2.resize(noise.astype(np.float32), (width, SHAPE[0]))
    flat = cv2.resize(rng.uniform(-1, 1, (8, width // 30)).astype(np.float32), (width, SHAPE[0]))
    return np.clip(110 + (result - 110) * (flat > 0), 0, 255)


def find(
    images: Iterable[Bytes], baseline_px: float = 0.0, points: PairPoints | None = None
) -> list[ImageFixed]:
    """What is found after each image."""
    detector = ImageFixedDetector(baseline_px)
    return [detector.update(half_size_pyramid(im), im.shape, points) for im in images]


def noisy(image: Floats32, number: int, sigma: float = 2.0) -> Bytes:
    """An image with noise of its own."""
    noise = np.random.default_rng(number).normal(0, sigma, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def panning(speed_px: float, count: int = 40) -> list[Floats32]:
    """A camera that turns past a scene."""
    scene = texture(1)
    shift = [np.array([[1, 0, -speed_px * i], [0, 1, 0]], np.float32) for i in range(count)]
    return [cv2.warpAffine(scene, by, SHAPE[::-1]) for by in shift]


def with_body(images: list[Floats32], top: int) -> list[Bytes]:
    """Images with a body below the row `top`."""
    body = texture(2, SHAPE[1])
    return [noisy(np.vstack([im[:top], body[top:]]), i) for i, im in enumerate(images)]


def passed_by(scene: Floats32, count: int, rows: slice, entered: int = 0) -> Iterable[Bytes]:
    """A train passes a camera at rest; `entered` pixels of it are there in the first image."""
    train = texture(7, 2000)
    for i in range(count):
        image, front = scene.copy(), min(entered + 6 * i, SHAPE[1])
        image[rows, :front] = train[rows, 1000 - 6 * i : 1000 - 6 * i + front]
        yield noisy(image, i)
