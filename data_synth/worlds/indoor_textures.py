"""Seeded grey textures of surfaces indoors, as (H, W) float32 in 0…1.

Some have little structure on purpose, as real painted walls do.
"""

from __future__ import annotations

import cv2
import numpy as np

from data_synth.scene.builder import Rng
from data_synth.worlds.textures import clipped, crack, noise, specks
from vo.base.types import Floats32

CEILING_TILE_PX = 64


def paint(rng: Rng, shape: tuple[int, int], shade: float = 0.68) -> Floats32:
    """A wall painted with a roller: little grain, a few marks of impacts."""
    image = shade + 0.02 * noise(rng, shape, 1.6) + 0.010 * noise(rng, shape, 0.5)
    specks(rng, image, count=image.size // 9000, radius=(1, 4), contrast=0.16)
    _scuffs(rng, image, count=image.size // 60_000, contrast=0.10)
    return clipped(image)


def linoleum(rng: Rng, shape: tuple[int, int], shade: float = 0.42) -> Floats32:
    """A sheet floor: marbled, speckled, with the arcs of chairs and heels."""
    image = shade + 0.03 * noise(rng, shape, 1.3) + 0.02 * noise(rng, shape, 0.5)
    specks(rng, image, count=image.size // 500, radius=(1, 3), contrast=0.22)
    _scuffs(rng, image, count=image.size // 14_000, contrast=0.16)
    return clipped(image)


def carpet(rng: Rng, shape: tuple[int, int], shade: float = 0.36) -> Floats32:
    """Carpet tiles of 128 texels in alternating directions, with loops and lint."""
    image = np.full(shape, shade, np.float32)
    side = 128
    for top in range(0, shape[0], side):
        for left in range(0, shape[1], side):
            pile = noise(rng, (side, side), 0.6, stretch=4.0)
            tile = pile if (top // side + left // side) % 2 else pile.T
            image[top : top + side, left : left + side] += 0.05 * tile + rng.normal(0, 0.03)
    specks(rng, image, count=image.size // 3000, radius=(1, 3), contrast=0.3)
    return clipped(image + 0.02 * noise(rng, shape, 1.6))


def ceiling_tiles(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Mineral-fibre tiles of CEILING_TILE_PX in a bright grid of bars, some stained by water."""
    image = 0.66 + 0.012 * noise(rng, shape, 1.2) + 0.012 * noise(rng, shape, 0.4)
    specks(rng, image, count=image.size // 260, radius=(1, 1), contrast=-0.28)
    step = CEILING_TILE_PX
    for top in range(0, shape[0], step):
        for left in range(0, shape[1], step):
            image[top : top + step, left : left + step] += rng.normal(0, 0.015)
            if rng.random() < 0.05:
                spot = (left + int(rng.integers(8, 48)), top + int(rng.integers(8, 48)))
                cv2.circle(image, spot, int(rng.integers(5, 13)), 0.55, 1, cv2.LINE_AA)
    for start, shade in ((0, 0.5), (1, 0.82), (2, 0.82)):
        image[start::step] = shade
        image[:, start::step] = shade
    return clipped(image)


def concrete(rng: Rng, shape: tuple[int, int], shade: float = 0.46) -> Floats32:
    """A worn floor: clouds, pores, cracks, oil, tyre marks and sawn joints."""
    image = shade + 0.05 * noise(rng, shape, 1.5) + 0.02 * noise(rng, shape, 0.7)
    specks(rng, image, count=image.size // 3000, radius=(1, 4), contrast=0.18)
    for _ in range(image.size // 60_000):
        crack(rng, image, contrast=-0.16)
    _tyre_marks(rng, image, count=image.size // 130_000)
    for _ in range(image.size // 90_000):
        _oil(rng, image)
    step = min(shape) // 2
    image[::step] -= 0.14
    image[:, ::step] -= 0.14
    return clipped(image)


def corrugated(rng: Rng, shape: tuple[int, int], shade: float = 0.58) -> Floats32:
    """Sheet metal with ribs along v, rows of screws, drips and dents."""
    ribs = np.sin(np.arange(shape[1]) * (2 * np.pi / 32)).astype(np.float32)
    image = np.tile(shade + 0.09 * np.tanh(2.0 * ribs), (shape[0], 1)).astype(np.float32)
    image += 0.025 * noise(rng, shape, 1.2, stretch=0.12) + 0.015 * noise(rng, shape, 0.7)
    for row in range(24, shape[0], 128):
        for column in range(8, shape[1], 32):
            cv2.circle(image, (column, row), 2, shade - 0.16, -1, cv2.LINE_AA)
    specks(rng, image, count=image.size // 5000, radius=(1, 4), contrast=0.2)
    return clipped(image)


def rack_steel(rng: Rng, shape: tuple[int, int], shade: float = 0.35) -> Floats32:
    """A perforated, painted upright: a row of slots along v, scratched."""
    image = shade + 0.02 * noise(rng, shape, 1.0) + 0.012 * noise(rng, shape, 0.4)
    for row in range(4, shape[0], 16):
        for column in range(4, shape[1], 16):
            image[row : row + 7, column : column + 4] = 0.65 * shade
    _scuffs(rng, image, count=image.size // 4000, contrast=0.25)
    return clipped(image)


def steel(rng: Rng, shape: tuple[int, int], shade: float = 0.5) -> Floats32:
    """Painted steel: smooth, with scratches and chips."""
    image = shade + 0.015 * noise(rng, shape, 1.3) + 0.01 * noise(rng, shape, 0.4)
    specks(rng, image, count=image.size // 4000, radius=(1, 3), contrast=-0.25)
    _scuffs(rng, image, count=image.size // 8000, contrast=0.2)
    return clipped(image)


def foliage(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Leaves over leaves, the lower ones darker."""
    image = 0.12 + 0.03 * noise(rng, shape, 1.0)
    count = image.size // 160
    for i in range(count):
        at = (int(rng.integers(0, shape[1])), int(rng.integers(0, shape[0])))
        axes = (int(rng.integers(7, 20)), int(rng.integers(3, 7)))
        shade = float(0.12 + 0.5 * (i / count) * rng.uniform(0.5, 1.3))
        angle = float(rng.uniform(0, 180))
        cv2.ellipse(image, at, axes, angle, 0, 360, shade, -1, cv2.LINE_AA)
        cv2.ellipse(image, at, (axes[0], 1), angle, 0, 360, shade + 0.12, -1, cv2.LINE_AA)
    return clipped(image)


def cloth(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Clothes: folds, weave, and stripes on some."""
    image = rng.uniform(0.15, 0.7) + 0.06 * noise(rng, shape, 1.5, stretch=0.4)
    image += 0.025 * noise(rng, shape, 0.5)
    if rng.random() < 0.5:
        period = int(rng.integers(10, 40))
        stripe = (np.arange(shape[0]) % period < period // 3).astype(np.float32)
        image += rng.normal(0, 0.12) * stripe[:, None]
    specks(rng, image, count=image.size // 4000, radius=(2, 6), contrast=0.25)
    return clipped(image)


def skin(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A face or a hand, with blots for its features."""
    image = rng.uniform(0.3, 0.62) + 0.03 * noise(rng, shape, 1.3)
    specks(rng, image, count=image.size // 3000, radius=(3, 10), contrast=-0.3)
    return clipped(image)


def hair(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Hair: strands along v."""
    return clipped(rng.uniform(0.06, 0.45) + 0.05 * noise(rng, shape, 0.8, stretch=0.2))


def _scuffs(rng: Rng, image: Floats32, count: int, contrast: float) -> None:
    """Short straight or bent strokes, lighter or darker."""
    for _ in range(count):
        u, v = (int(rng.integers(0, n)) for n in image.shape[::-1])
        axes = tuple(int(a) for a in rng.integers(10, 90, 2))
        turn, start = float(rng.uniform(0, 180)), float(rng.uniform(0, 360))
        sweep = float(rng.uniform(8, 35))
        shade = float(image[v, u]) + contrast * float(rng.uniform(-1, 1))
        cv2.ellipse(image, (u, v), axes, turn, start, start + sweep, shade, 1, cv2.LINE_AA)


def _tyre_marks(rng: Rng, image: Floats32, count: int) -> None:
    """Long bent bands in pairs, as of the two wheels of an axle."""
    layer = np.zeros(image.shape, np.float32)
    for _ in range(count):
        centre = tuple(int(c) for c in rng.uniform(-0.3, 1.3, 2) * image.shape[::-1])
        radius, start = int(rng.integers(80, 900)), float(rng.uniform(0, 360))
        sweep, shade = float(rng.uniform(15, 70)), float(rng.uniform(0.02, 0.09))
        for apart in (0, int(rng.integers(60, 140))):
            axes = (radius + apart, radius + apart)
            width = int(rng.integers(8, 20))
            cv2.ellipse(layer, centre, axes, 0.0, start, start + sweep, shade, width, cv2.LINE_AA)
    image -= layer * (1.0 + 0.4 * noise(rng, image.shape, 0.3))


def _oil(rng: Rng, image: Floats32) -> None:
    layer = np.zeros(image.shape, np.float32)
    u, v = (int(rng.integers(0, n)) for n in image.shape[::-1])
    for _ in range(int(rng.integers(2, 7))):
        at = (u + int(rng.normal(0, 22)), v + int(rng.normal(0, 22)))
        cv2.circle(layer, at, int(rng.integers(4, 26)), float(rng.uniform(0.04, 0.13)), -1)
    image -= cv2.GaussianBlur(layer, (0, 0), 2.0)
