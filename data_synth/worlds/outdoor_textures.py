"""Seeded grey textures of streets and fields, as (H, W) float32 in 0…1."""

from __future__ import annotations

import cv2
import numpy as np

from data_synth.scene.builder import Rng
from data_synth.worlds.textures import clipped, crack, noise, specks
from vo.base.types import Floats32

_WORDS = (
    "BAKERY",
    "CAFE",
    "BOOKS",
    "PHARMACY",
    "FLOWERS",
    "HOTEL",
    "BANK",
    "MARKET",
    "TAILOR",
    "RADIO",
    "OPTIK",
    "PIZZA",
    "BAR",
    "SHOES",
    "BIKES",
    "WINE",
    "TOYS",
    "TRAVEL",
    "BUTCHER",
    "FISH",
    "LOANS",
    "TEA",
    "MUSIC",
    "TOOLS",
    "HATS",
    "KEYS",
    "PAINT",
    "DENTIST",
    "POST",
    "GARAGE",
)


def asphalt(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Worn asphalt: stones, tar seams, cracks and oil spots."""
    image = 0.46 + 0.035 * noise(rng, shape, 1.3) + 0.05 * noise(rng, shape, 0.4)
    specks(rng, image, image.size // 700, (1, 3), 0.22)
    specks(rng, image, image.size // 60_000, (6, 26), -0.07)
    for _ in range(image.size // 30_000):
        crack(rng, image, -0.14)
    return clipped(image)


def paving(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Rows of paving slabs, each of its own shade; 32 texels a slab."""
    image = 0.56 + 0.03 * noise(rng, shape, 1.2) + 0.03 * noise(rng, shape, 0.4)
    _slabs(rng, image, (32, 48), 2, 0.055, -0.2)
    specks(rng, image, image.size // 1500, (1, 4), -0.22)
    return clipped(image)


def cobbles(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Small sett stones with sunken joints; 12 texels a stone."""
    image = 0.43 + 0.03 * noise(rng, shape, 1.2) + 0.04 * noise(rng, shape, 0.5)
    _slabs(rng, image, (12, 14), 2, 0.07, -0.15)
    return clipped(image)


def concrete(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Concrete with formwork joints, runs of rain and pores."""
    image = 0.56 + 0.04 * noise(rng, shape, 1.5) + 0.02 * noise(rng, shape, 0.5)
    image += 0.03 * noise(rng, shape, 1.2, stretch=0.12)
    specks(rng, image, image.size // 1500, (1, 3), -0.2)
    image[::128] -= 0.12
    image[:, ::256] -= 0.12
    return clipped(image)


def render_coat(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Rough plaster of a house wall, with runs of rain."""
    image = rng.uniform(0.55, 0.72) + 0.035 * noise(rng, shape, 1.4)
    image += 0.02 * noise(rng, shape, 0.4) + 0.025 * noise(rng, shape, 1.2, stretch=0.1)
    specks(rng, image, image.size // 4000, (1, 4), 0.2)
    return clipped(image)


def brickwork(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Bricks in mortar; 8 x 24 texels a brick."""
    image = 0.4 + 0.03 * noise(rng, shape, 1.3) + 0.03 * noise(rng, shape, 0.6)
    for course in range(shape[0] // 8):
        row = image[course * 8 : course * 8 + 8]
        shades = np.repeat(rng.normal(0, 0.06, -(-shape[1] // 24)), 24)[: shape[1]]
        row += np.roll(shades, 12 * (course % 2)).astype(np.float32)
        row[:, 12 * (course % 2) :: 24] = 0.58
        row[:1] = 0.58
    return clipped(image)


def roof_tiles(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Overlapping tiles, dark below each edge; 16 texels a tile."""
    image = 0.3 + 0.03 * noise(rng, shape, 1.3) + 0.02 * noise(rng, shape, 0.5)
    _slabs(rng, image, (16, 12), 2, 0.05, -0.12)
    return clipped(image)


def leaves(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Foliage: leaves and clumps of leaves before dark gaps."""
    image = 0.12 + 0.04 * noise(rng, shape, 1.2)
    clumps = noise(rng, shape, 1.5)
    count = image.size // 28
    at = rng.integers(0, (shape[1], shape[0]), (count, 2))
    for u, v in at:
        shade = 0.36 + 0.08 * clumps[v, u] + 0.11 * float(rng.standard_normal())
        axes = (int(rng.integers(2, 6)), int(rng.integers(1, 4)))
        _blob(image, (int(u), int(v)), axes, float(rng.uniform(0, 180)), float(shade))
    return clipped(image)


def bark(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Bark with upright furrows."""
    image = 0.3 + 0.08 * noise(rng, shape, 0.9, stretch=0.15) + 0.03 * noise(rng, shape, 0.5)
    return clipped(image)


def grass(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Grass: tufts, blades and bare spots."""
    image = 0.33 + 0.045 * noise(rng, shape, 1.2) + 0.05 * noise(rng, shape, 0.4)
    specks(rng, image, image.size // 900, (1, 4), 0.14)
    specks(rng, image, image.size // 7000, (3, 9), -0.1)
    return clipped(image)


def metal(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Painted metal with scratches and rust."""
    image = rng.uniform(0.25, 0.5) + 0.03 * noise(rng, shape, 1.3) + 0.012 * noise(rng, shape, 0.5)
    specks(rng, image, image.size // 5000, (1, 5), -0.2)
    return clipped(image)


def white_paint(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Road paint, worn through to the asphalt in places."""
    worn = noise(rng, shape, 1.0) + 0.7 * noise(rng, shape, 0.4)
    image = np.where(worn > 1.7, 0.45, 0.8).astype(np.float32) + 0.03 * noise(rng, shape, 0.5)
    return clipped(image)


def zebra(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Bars of a crossing along v, side by side along u."""
    u = np.arange(shape[1]) * 16 // shape[1]
    bars = np.broadcast_to((u % 2 == 0)[None, :], shape)
    worn = noise(rng, shape, 1.0) + 0.7 * noise(rng, shape, 0.4) > 1.5
    image = np.where(bars & ~worn, 0.78, 0.38).astype(np.float32)
    return clipped(image + 0.035 * noise(rng, shape, 0.4))


def manhole(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """An iron lid with a raised pattern."""
    image = 0.26 + 0.04 * noise(rng, shape, 0.6)
    _slabs(rng, image, (shape[0] // 10, shape[1] // 10), max(2, shape[0] // 40), 0.03, 0.16)
    middle, radius = (shape[1] // 2, shape[0] // 2), shape[0] // 2
    cv2.circle(image, middle, int(radius * 0.92), 0.5, max(2, radius // 14), cv2.LINE_AA)
    return clipped(image)


def shop_sign(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A board with the name of a shop."""
    dark = rng.random() < 0.5
    ground = float(rng.uniform(0.1, 0.3) if dark else rng.uniform(0.6, 0.85))
    image = np.full(shape, ground, np.float32) + 0.01 * noise(rng, shape, 1.0)
    title(image, str(rng.choice(_WORDS)), 0.85 if dark else 0.1)
    cv2.rectangle(image, (0, 0), (shape[1] - 1, shape[0] - 1), 0.9 if dark else 0.15, 3)
    return clipped(image)


def placard(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A poster: patches, with words above and below."""
    image = rng.uniform(0.3, 0.75) + 0.07 * noise(rng, shape, 1.4)
    height, width = shape
    for _ in range(7):
        at = (int(rng.integers(width)), int(rng.integers(height // 4, 3 * height // 4)))
        axes = (int(rng.integers(6, width // 5)), int(rng.integers(6, height // 6)))
        _blob(image, at, axes, float(rng.uniform(0, 180)), float(rng.uniform(0.08, 0.9)))
    for top in (0, 4 * height // 5):
        band = image[top : top + height // 5]
        band[:] = ground = float(rng.uniform(0.1, 0.85))
        title(band, str(rng.choice(_WORDS)), 0.9 if ground < 0.5 else 0.08)
    return clipped(image)


def glass(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Panes of a car: dark, and paler at the top, where they reflect the sky."""
    fall = np.linspace(0.26, 0.07, shape[0], dtype=np.float32)[:, None]
    image = fall + 0.03 * noise(rng, shape, 1.6)
    return clipped(image)


def road_sign(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A traffic sign: a ring, a triangle or an arrow, with a number."""
    image = np.full(shape, 0.82, np.float32)
    height, width = shape
    middle, ink = (width // 2, height // 2), float(rng.uniform(0.08, 0.3))
    if rng.random() < 0.5:
        cv2.circle(image, middle, int(0.42 * width), ink, width // 10, cv2.LINE_AA)
    else:
        image[:] = ink
        corners = [(width // 2, height // 8), (width // 8, 7 * height // 8)]
        corners.append((7 * width // 8, 7 * height // 8))
        cv2.fillPoly(image, [np.array(corners, np.int32)], 0.85, cv2.LINE_AA)
    patch = image[height // 3 : 2 * height // 3, width // 4 : 3 * width // 4]
    title(patch, str(rng.integers(10, 99)), ink * 0.5)
    return clipped(image)


def forest(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A wooded hillside from afar: crowns lit from above, dark between."""
    image = 0.2 + 0.03 * noise(rng, shape, 1.4)
    for u, v in rng.integers(0, (shape[1], shape[0]), (image.size // 60, 2)):
        shade = 0.2 + 0.05 * float(rng.standard_normal())
        radius = int(rng.integers(3, 8))
        _blob(image, (int(u), int(v)), (radius, radius), 0.0, shade)
        _blob(image, (int(u), int(v) - radius // 3), (radius // 2, radius // 3), 0.0, shade + 0.1)
    return clipped(image + 0.02 * noise(rng, shape, 0.5))


def title(image: Floats32, text: str, shade: float) -> None:
    """Write a text as large as fits into the middle of an image."""
    font, height, width = cv2.FONT_HERSHEY_DUPLEX, *image.shape
    (w, h), _ = cv2.getTextSize(text, font, 1.0, 2)
    scale = min(0.86 * width / w, 0.62 * height / h)
    stroke = max(1, round(1.6 * scale))
    ink = np.zeros(image.shape, np.uint8)  # OpenCV 5 writes text on 8-bit images only
    at = (int((width - scale * w) / 2), int((height + scale * h) / 2))
    cv2.putText(ink, text, at, font, scale, 255, stroke, cv2.LINE_AA)
    image += (shade - image) * (ink / np.float32(255))


def _slabs(
    rng: Rng, image: Floats32, size: tuple[int, int], gap: int, spread: float, joint: float
) -> None:
    """Shade stones of `size` (along v, u) one by one, laid in bond, and draw their joints."""
    rows, columns = -(-image.shape[0] // size[0]), -(-image.shape[1] // size[1])
    shades = np.repeat(rng.normal(0, spread, (rows, columns)), size[1], axis=1)
    for row in range(rows):
        shift = (row % 2) * size[1] // 2
        strip = image[row * size[0] : (row + 1) * size[0]]
        strip += np.roll(shades[row], shift)[: image.shape[1]].astype(np.float32)
        strip[:gap] += joint
        for k in range(gap):
            strip[gap:, (shift + k) % size[1] :: size[1]] += joint


def _blob(
    image: Floats32, at: tuple[int, int], axes: tuple[int, int], turn_deg: float, shade: float
) -> None:
    cv2.ellipse(image, at, axes, turn_deg, 0, 360, shade, -1, cv2.LINE_AA)
