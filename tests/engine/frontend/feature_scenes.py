"""Pictures with known content for the tests of features."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.types import Bytes, Floats


def shapes(height: int, width: int, seed: int = 0, density: float = 1 / 500) -> Bytes:
    """Overlapping triangles and quadrangles, dark or bright, on a mid-grey ground."""
    rng = np.random.default_rng(seed)
    image = np.full((height, width), 128, np.uint8)
    for _ in range(int(height * width * density)):
        centre = rng.uniform((0, 0), (width, height))
        corners = centre + rng.uniform(-16, 16, (int(rng.integers(3, 5)), 2))
        hull = cv2.convexHull(corners.astype(np.int32))
        grey = 128 + int(rng.choice((-1, 1)) * rng.integers(70, 110))
        cv2.fillConvexPoly(image, hull, grey, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), dtype=np.uint8)


class Waves:
    """A texture known at every real position: a sum of plane waves."""

    def __init__(self, seed: int = 0, shortest_px: float = 8.0, longest_px: float = 30.0) -> None:
        rng = np.random.default_rng(seed)
        count = 60
        turn = rng.uniform(0, 2 * np.pi, count)
        length = 2 * np.pi / rng.uniform(shortest_px, longest_px, count)
        self._wave = np.column_stack([np.cos(turn), np.sin(turn)]) * length[:, None]
        self._phase = rng.uniform(0, 2 * np.pi, count)
        self._height = 50.0 / np.sqrt(count / 2)

    def at(self, xy: Floats) -> Floats:
        """Grey at positions (..., 2)."""
        phase = np.tensordot(xy, self._wave, axes=(-1, 1)) + self._phase
        return np.asarray(128.0 + self._height * np.cos(phase).sum(axis=-1))


def pixels(height: int, width: int) -> Floats:
    """Positions (H, W, 2) of all pixels."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float64)


def as_image(grey: Floats) -> Bytes:
    return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)
