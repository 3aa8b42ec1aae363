"""Seeded grey textures with structure at many scales, as (H, W) float32 in 0…1."""

from __future__ import annotations

import string

import cv2
import numpy as np

from data_synth.scene.builder import Rng
from vo.base.types import Floats32

_LETTERS = np.array(list(string.ascii_uppercase + string.digits))


def noise(rng: Rng, shape: tuple[int, int], slope: float = 1.0, stretch: float = 1.0) -> Floats32:
    """Noise with amplitude ~ 1/f^slope, zero mean, unit deviation; periodic.

    `slope`: 0 is white, 1 is like natural images, more is smoother. `stretch`: ratio of the size of
    its grains along u to that along v.
    """
    white = rng.standard_normal(shape, dtype=np.float32)
    fv = np.fft.fftfreq(shape[0]).astype(np.float32)[:, None]
    fu = np.fft.rfftfreq(shape[1]).astype(np.float32)[None, :] * np.float32(stretch)
    frequency = np.sqrt(fv * fv + fu * fu)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(white) * frequency ** np.float32(-slope)
    grains = np.fft.irfft2(spectrum, s=shape)
    return np.asarray(grains / grains.std(), dtype=np.float32)


def plaster(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A painted wall: soft stains, fine grain, specks and a few cracks."""
    image = 0.68 + 0.045 * noise(rng, shape, 1.5) + 0.025 * noise(rng, shape, 0.7)
    specks(rng, image, count=image.size // 2200, radius=(1, 5), contrast=0.3)
    for _ in range(max(2, image.size // 150_000)):
        crack(rng, image)
    return clipped(image)


def ceiling(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Mineral-fibre panels in a grid: pores and slightly different panels."""
    image = 0.74 + 0.02 * noise(rng, shape, 1.2) + 0.02 * noise(rng, shape, 0.4)
    specks(rng, image, count=image.size // 900, radius=(1, 3), contrast=-0.3)
    step = 80
    for row in range(0, shape[0], step):
        for column in range(0, shape[1], step):
            image[row : row + step, column : column + step] += rng.normal(0, 0.02)
    image[::step] = image[1::step] = 0.45
    image[:, ::step] = image[:, 1::step] = 0.45
    return clipped(image)


def bricks(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Courses of bricks, each of its own shade, in rough mortar."""
    image = 0.66 + 0.04 * noise(rng, shape, 0.8)
    height, width, gap = 19, 54, 3
    for course, top in enumerate(range(0, shape[0], height)):
        for left in range(-width * (course % 2) // 2, shape[1], width):
            _brick(rng, image, (top, left), (height - gap, width - gap))
    image += 0.05 * noise(rng, shape, 0.8) + 0.03 * noise(rng, shape, 1.5)
    specks(rng, image, count=image.size // 3000, radius=(1, 4), contrast=0.25)
    return clipped(image)


def planks(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A floor of boards with grain along u, knots, dark gaps and scratches."""
    image = 0.5 + 0.06 * noise(rng, shape, 1.0, stretch=9.0) + 0.02 * noise(rng, shape, 0.6)
    height = 32
    for top in range(0, shape[0], height):
        left = -int(rng.integers(0, 300))
        while left < shape[1]:
            length = int(rng.integers(180, 420))
            board = image[top : top + height, max(left, 0) : left + length]
            board += rng.normal(0, 0.075)
            board[:2] -= 0.16
            board[:, :2] -= 0.16
            left += length
    specks(rng, image, count=image.size // 2000, radius=(1, 6), contrast=-0.4)
    for _ in range(image.size // 60_000):
        crack(rng, image, contrast=0.12)
    return clipped(image)


def wood(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A wooden panel: grain along u, knots and dents."""
    image = rng.uniform(0.4, 0.66) + 0.07 * noise(rng, shape, 1.0, stretch=7.0)
    image += 0.025 * noise(rng, shape, 0.7)
    specks(rng, image, count=image.size // 1800, radius=(1, 5), contrast=-0.35)
    return clipped(image)


def fabric(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Plaid cloth: crossing bands of random width, weave and lint."""
    image = 0.45 + 0.035 * noise(rng, shape, 0.9)
    for axis in (0, 1):
        bands = np.repeat(rng.normal(0, 0.09, shape[axis] // 12 + 1), 12)[: shape[axis]]
        image += bands.astype(np.float32).reshape((-1, 1) if axis == 0 else (1, -1))
    specks(rng, image, count=image.size // 2500, radius=(1, 3), contrast=0.25)
    return clipped(image)


def carton(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Cardboard with tape, stamps and print."""
    image = rng.uniform(0.45, 0.6) + 0.03 * noise(rng, shape, 0.8) + 0.03 * noise(rng, shape, 1.5)
    for _ in range(max(2, image.size // 40_000)):
        top, left = (int(rng.integers(0, n)) for n in shape)
        image[top : top + int(rng.integers(14, 30)), left : left + 220] += rng.normal(0, 0.1)
    for _ in range(max(6, image.size // 9_000)):
        word(rng, image, dark=True)
    return clipped(image)


def books(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Spines of books side by side along u, each with bands and a title."""
    image = np.zeros(shape, np.float32)
    left = 0
    while left < shape[1]:
        width = int(rng.integers(9, 24))
        shade = rng.uniform(0.15, 0.85)
        image[:, left : left + width] = shade
        for _ in range(int(rng.integers(2, 6))):
            top = int(rng.integers(0, shape[0]))
            contrast = rng.uniform(0.15, 0.4) * (1 if shade < 0.5 else -1)
            image[top : top + int(rng.integers(3, 22)), left + 2 : left + width - 2] += contrast
        image[:, left : left + 1] = 0.08
        left += width
    return clipped(image + 0.03 * noise(rng, shape, 0.8))


def poster(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A print: patches, discs and words on a 1/f background, with a frame."""
    image = rng.uniform(0.35, 0.75) + 0.09 * noise(rng, shape, 1.3)
    for _ in range(int(rng.integers(9, 16))):
        centre = tuple(int(rng.integers(0, n)) for n in shape[::-1])
        shade = float(rng.uniform(0.05, 0.95))
        if rng.random() < 0.5:
            cv2.circle(image, centre, int(rng.integers(5, 34)), shade, -1, cv2.LINE_AA)
        else:
            corner = (centre[0] + int(rng.integers(8, 70)), centre[1] + int(rng.integers(6, 50)))
            cv2.rectangle(image, centre, corner, shade, -1)
    for _ in range(int(rng.integers(5, 9))):
        word(rng, image, dark=rng.random() < 0.5)
    cv2.rectangle(image, (0, 0), (shape[1] - 1, shape[0] - 1), 0.12, 9)
    return clipped(image + 0.02 * noise(rng, shape, 0.8))


def rug(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A carpet of nested frames and random motifs."""
    image = np.full(shape, rng.uniform(0.3, 0.6), np.float32)
    for inset in range(0, min(shape) // 3, 22):
        shade = float(rng.uniform(0.15, 0.85))
        corner = (shape[1] - 1 - inset, shape[0] - 1 - inset)
        cv2.rectangle(image, (inset, inset), corner, shade, int(rng.integers(3, 12)))
    for _ in range(image.size // 1500):
        u, v = (int(rng.integers(0, n)) for n in shape[::-1])
        reach = int(rng.integers(3, 11))
        diamond = np.array([[u - reach, v], [u, v - reach], [u + reach, v], [u, v + reach]])
        cv2.fillPoly(image, [diamond], float(rng.uniform(0.15, 0.85)), cv2.LINE_AA)
    return clipped(image + 0.05 * noise(rng, shape, 0.5))


def clipped(image: Floats32) -> Floats32:
    """Clip to 0.03…0.97, as no real surface is purely black or white."""
    return np.asarray(np.clip(image, 0.03, 0.97), dtype=np.float32)


def specks(rng: Rng, image: Floats32, count: int, radius: tuple[int, int], contrast: float) -> None:
    """Draw small blots, each lighter or darker by up to `contrast`."""
    height, width = image.shape
    for _ in range(count):
        u, v = int(rng.integers(0, width)), int(rng.integers(0, height))
        axes = tuple(int(a) for a in rng.integers(radius[0], radius[1] + 1, 2))
        shade = float(image[v, u]) + contrast * float(rng.uniform(-1, 1))
        angle = float(rng.uniform(0, 180))
        cv2.ellipse(image, (u, v), axes, angle, 0, 360, shade, -1, cv2.LINE_AA)


def crack(rng: Rng, image: Floats32, contrast: float = -0.2) -> None:
    """Draw a thin wandering line."""
    start = rng.uniform((0, 0), image.shape[::-1])
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.5, 12))
    steps = np.column_stack([np.cos(heading), np.sin(heading)]) * rng.uniform(4, 14)
    points = np.round(start + np.cumsum(steps, axis=0)).astype(np.int32)
    u, v = (int(c) % n for c, n in zip(start, image.shape[::-1], strict=True))
    cv2.polylines(image, [points], False, float(image[v, u]) + contrast, 1, cv2.LINE_AA)


def _brick(rng: Rng, image: Floats32, corner: tuple[int, int], size: tuple[int, int]) -> None:
    top, left = corner
    bottom, right = top + size[0] + int(rng.integers(-1, 2)), left + size[1]
    image[top:bottom, max(left, 0) : max(right, 0)] = rng.normal(0.42, 0.085)


def word(rng: Rng, image: Floats32, dark: bool) -> None:
    """Print a few letters somewhere."""
    text = "".join(rng.choice(_LETTERS, int(rng.integers(2, 9))))
    at = (int(rng.integers(0, image.shape[1])), int(rng.integers(0, image.shape[0])))
    shade = float(rng.uniform(0.02, 0.2) if dark else rng.uniform(0.8, 0.97))
    scale = float(rng.uniform(0.4, 1.3))
    ink = np.zeros(image.shape, np.uint8)  # OpenCV 5 writes text on 8-bit images only
    cv2.putText(ink, text, at, cv2.FONT_HERSHEY_DUPLEX, scale, 255, 1, cv2.LINE_AA)
    image += (shade - image) * (ink / np.float32(255))
