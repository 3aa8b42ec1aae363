"""Seeded grey textures of printed or patterned objects: signs, boards, doors, goods.

They are meant to be fitted to a face, so their first row is its upper edge.
"""

from __future__ import annotations

import cv2
import numpy as np

from data_synth.scene.builder import Rng
from data_synth.worlds.textures import clipped, noise, poster, specks, word
from vo.base.types import Floats32


def sign(rng: Rng, shape: tuple[int, int], text: str, dark_ground: bool = False) -> Floats32:
    """A plate with a frame and one word that fills it."""
    ground, ink = (0.14, 0.9) if dark_ground else (0.85, 0.08)
    image = np.full(shape, ground, np.float32)
    cv2.rectangle(image, (3, 3), (shape[1] - 4, shape[0] - 4), ink, max(2, min(shape) // 40))
    _text(image, text, (shape[1] / 2, shape[0] / 2), (0.86 * shape[1], 0.8 * shape[0]), ink)
    return clipped(image + 0.015 * noise(rng, shape, 0.9))


def pictogram(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """An emergency-exit sign: a figure, an arrow and a door, white on green."""
    image = np.full(shape, 0.34, np.float32)
    h, w = shape
    cv2.rectangle(image, (int(0.68 * w), int(0.15 * h)), (int(0.9 * w), int(0.88 * h)), 0.95, -1)
    cv2.circle(image, (int(0.5 * w), int(0.25 * h)), int(0.08 * h), 0.95, -1, cv2.LINE_AA)
    joints = np.array([[0.48, 0.36], [0.44, 0.6], [0.53, 0.7], [0.48, 0.9]])
    arms = np.array([[0.38, 0.52], [0.46, 0.4], [0.56, 0.5]])
    leg = np.array([[0.44, 0.6], [0.38, 0.74], [0.3, 0.74]])
    for limb in (joints, arms, leg):
        points = np.round(limb * (w, h)).astype(np.int32)
        cv2.polylines(image, [points], False, 0.95, max(2, h // 14), cv2.LINE_AA)
    head, tail = (int(0.06 * w), h // 2), (int(0.26 * w), h // 2)
    cv2.arrowedLine(image, tail, head, 0.95, max(2, h // 14), cv2.LINE_AA, tipLength=0.5)
    return clipped(image + 0.01 * noise(rng, shape, 0.9))


def notices(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A cork board with papers pinned over each other: print, lists and pictures."""
    image = 0.42 + 0.05 * noise(rng, shape, 0.6)
    specks(rng, image, count=image.size // 300, radius=(1, 2), contrast=0.2)
    for _ in range(int(rng.integers(24, 36))):
        height, width = int(rng.integers(50, 120)), int(rng.integers(40, 110))
        top = int(rng.integers(8, max(9, shape[0] - height - 8)))
        left = int(rng.integers(8, max(9, shape[1] - width - 8)))
        sheet = _sheet(rng, (height, width))[: shape[0] - top, : shape[1] - left]
        bottom, right = top + sheet.shape[0], left + sheet.shape[1]
        image[top + 2 : bottom + 2, left + 2 : right + 2] *= 0.7  # its shadow
        image[top:bottom, left:right] = sheet
        cv2.circle(image, (left + width // 2, top + 5), 3, float(rng.uniform(0.05, 0.9)), -1)
    cv2.rectangle(image, (0, 0), (shape[1] - 1, shape[0] - 1), 0.22, 8)
    return clipped(image)


def door_leaf(rng: Rng, shape: tuple[int, int], shade: float = 0.5) -> Floats32:
    """A flush door: upright grain, a kick plate and fingerprints."""
    image = shade + 0.03 * noise(rng, shape, 1.1, stretch=0.12) + 0.012 * noise(rng, shape, 0.5)
    plate = int(0.9 * shape[0])
    image[plate:] = 0.5 + 0.02 * noise(rng, shape, 1.0, stretch=8.0)[plate:]
    image[plate : plate + 2] = 0.2
    cv2.rectangle(image, (0, 0), (shape[1] - 1, shape[0] - 1), shade - 0.25, 2)
    specks(rng, image, count=image.size // 7000, radius=(1, 4), contrast=-0.2)
    return clipped(image)


def view_outside(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """The view from a window: pale sky, houses out of focus and the tops of trees."""
    height, width = shape
    image = np.linspace(0.97, 0.82, height, dtype=np.float32)[:, None] * np.ones(shape, np.float32)
    image += 0.02 * noise(rng, shape, 1.8, stretch=2.0)
    for left in range(0, width, max(8, width // 7)):
        top = int(height * rng.uniform(0.45, 0.75))
        house = image[top:, left : left + int(width * rng.uniform(0.08, 0.2))]
        house[:] = rng.uniform(0.4, 0.7)
        house[6::14, :] -= 0.14
    trees = height * (0.82 + 0.05 * noise(rng, (1, width), 1.0)[0])
    rows = np.arange(height)[:, None]
    leaves = 0.3 + 0.08 * noise(rng, shape, 0.9)
    image = np.where(rows > trees[None, :], leaves, image).astype(np.float32)
    return clipped(cv2.GaussianBlur(image, (0, 0), 1.2))


def radiator(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Upright ribs of a flat radiator."""
    across = np.arange(shape[1]) % 16
    ribs = np.where(across < 2, 0.45, 0.78 - 0.006 * across).astype(np.float32)
    image = ribs + 0.012 * noise(rng, shape, 1.0)
    for row in (0, shape[0] - 14):
        image[row : row + 14] = 0.74
        image[row + 12 : row + 14] = 0.4
    return clipped(image)


def machine(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """The front of a vending machine or copier: rows of goods, keys and labels."""
    image = np.full(shape, rng.uniform(0.25, 0.6), np.float32) + 0.01 * noise(rng, shape, 1.0)
    h, w = shape
    image[int(0.06 * h) : int(0.78 * h), int(0.07 * w) : int(0.72 * w)] = 0.12
    rows, columns = 6, 6
    for row in range(rows):
        bottom = int(h * (0.06 + 0.72 * (row + 1) / rows)) - 4
        image[bottom : bottom + 3, int(0.07 * w) : int(0.72 * w)] = 0.7
        for column in range(columns):
            left = int(w * (0.08 + 0.64 * column / columns))
            top = bottom - int(h * rng.uniform(0.05, 0.1))
            shade = float(rng.uniform(0.25, 0.95))
            cv2.rectangle(image, (left, top), (left + int(0.075 * w), bottom - 1), shade, -1)
            middle = (top + bottom) // 2
            cv2.rectangle(image, (left, middle), (left + int(0.075 * w), middle + 5), 1 - shade, -1)
    image[int(0.3 * h) : int(0.45 * h) : 9, int(0.78 * w) : int(0.92 * w)] = 0.85
    cv2.rectangle(image, (int(0.1 * w), int(0.84 * h)), (int(0.7 * w), int(0.94 * h)), 0.07, -1)
    return clipped(image)


def shutter(rng: Rng, shape: tuple[int, int], text: str) -> Floats32:
    """A sectional loading door: slats, a row of small windows, its number, scrapes."""
    image = rng.uniform(0.55, 0.68) + 0.02 * noise(rng, shape, 1.3) + 0.01 * noise(rng, shape, 0.4)
    step = shape[0] // 16
    image[::step] -= 0.22
    image[1::step] += 0.08
    row = 6 * step
    for left in range(shape[1] // 10, shape[1] - shape[1] // 8, shape[1] // 5):
        right = left + shape[1] // 8
        cv2.rectangle(image, (left, row + 6), (right, row + 2 * step - 6), 0.93, -1)
        cv2.rectangle(image, (left, row + 6), (right, row + 2 * step - 6), 0.15, 3)
    reach = (0.4 * shape[1], 0.36 * shape[0])
    _text(image, text, (shape[1] / 2, 0.72 * shape[0]), reach, 0.1)
    specks(rng, image, count=image.size // 3000, radius=(1, 6), contrast=-0.3)
    return clipped(image)


def carton_stack(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Equal cartons of a pallet in courses, with tape and print, under film."""
    rows, columns = int(rng.integers(2, 5)), int(rng.integers(2, 4))
    base = float(rng.uniform(0.35, 0.62))
    image = base + 0.025 * noise(rng, shape, 1.4) + 0.012 * noise(rng, shape, 0.6)
    height, width = shape[0] // rows, shape[1] // columns
    for row in range(rows):
        for column in range(-1, columns):
            left = column * width + (row % 2) * width // 2
            box = image[row * height : (row + 1) * height, max(left, 0) : max(left + width, 0)]
            if box.size:
                _carton(rng, box)
    if rng.random() < 0.6:
        film = np.abs(noise(rng, shape, 1.1, stretch=0.3))
        image += 0.05 * np.maximum(film - 1.0, 0.0)
    return clipped(image)


def barrel(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A drum: hoops across, a label, rust and dents."""
    image = rng.uniform(0.2, 0.6) + 0.03 * noise(rng, shape, 1.2) + 0.015 * noise(rng, shape, 0.5)
    for fraction in (0.04, 0.34, 0.66, 0.95):
        row = int(fraction * shape[0])
        image[row : row + 5] += 0.14
        image[row + 5 : row + 9] -= 0.14
    for left in range(shape[1] // 8, shape[1], shape[1] // 2):
        sheet = _sheet(rng, (shape[0] // 4, shape[1] // 5))
        top = int(0.39 * shape[0])
        image[top : top + sheet.shape[0], left : left + sheet.shape[1]] = sheet
    specks(rng, image, count=image.size // 3000, radius=(1, 6), contrast=-0.2)
    return clipped(image)


def sackcloth(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A filled paper sack: creases and print."""
    image = rng.uniform(0.5, 0.7) + 0.05 * noise(rng, shape, 1.2) + 0.02 * noise(rng, shape, 0.5)
    for _ in range(3):
        word(rng, image, dark=True)
    return clipped(image)


def hazard(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Slanting warning stripes, chipped."""
    rows, columns = np.indices(shape)
    image = np.where((rows + columns) % 32 < 16, 0.72, 0.1).astype(np.float32)
    specks(rng, image, count=image.size // 400, radius=(1, 3), contrast=0.4)
    return clipped(image + 0.02 * noise(rng, shape, 0.8))


def extinguisher(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A fire extinguisher's bottle with the label all round."""
    image = 0.3 + 0.015 * noise(rng, shape, 1.2)
    top, bottom = int(0.3 * shape[0]), int(0.75 * shape[0])
    for left in range(6, shape[1] - 20, shape[1] // 2):
        wide = shape[1] // 2 - 14
        image[top:bottom, left : left + wide] = _sheet(rng, (bottom - top, wide))
    return clipped(image)


def lamp_panel(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A ceiling lamp: a bright louvre in a frame."""
    image = 0.9 + 0.01 * noise(rng, shape, 1.0)
    image[::16], image[:, ::32] = 0.72, 0.66
    cv2.rectangle(image, (0, 0), (shape[1] - 1, shape[0] - 1), 0.5, 6)
    return clipped(image)


def pallet(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A pallet from its front: boards, blocks and the dark between them."""
    image = 0.55 + 0.05 * noise(rng, shape, 1.0, stretch=6.0)
    gap = slice(int(0.2 * shape[0]), int(0.82 * shape[0]))
    for left in (0.13, 0.57):
        image[gap, int(left * shape[1]) : int((left + 0.3) * shape[1])] = 0.05
    return clipped(image)


def girder(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """The web of a cellular girder: one round hole, to be repeated."""
    image = 0.45 + 0.015 * noise(rng, shape, 1.2)
    middle = (shape[1] // 2, shape[0] // 2)
    cv2.circle(image, middle, int(0.32 * shape[0]), 0.12, -1, cv2.LINE_AA)
    cv2.circle(image, middle, int(0.34 * shape[0]), 0.6, 3, cv2.LINE_AA)
    return clipped(image)


def worn_paint(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Paint on a floor, rubbed through in places."""
    wear = noise(rng, shape, 0.9)
    image = np.where(wear > 1.1, 0.45, 0.76) + 0.02 * noise(rng, shape, 0.5)
    return clipped(np.asarray(image, dtype=np.float32))


def label(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A small print for the front of an object: lines of type and a bar code."""
    return clipped(_sheet(rng, shape))


def _carton(rng: Rng, box: Floats32) -> None:
    """Draw one carton of a stack in place: its shade, edges, tape and label."""
    box += rng.normal(0, 0.045)
    for edge in (box[:2], box[-2:], box[:, :2], box[:, -2:]):
        edge -= 0.12
    height, width = box.shape
    tape = height // 2
    box[tape - 4 : tape + 4] += 0.1
    if width > 40 and rng.random() < 0.4:
        tall, wide = int(height * rng.uniform(0.2, 0.34)), int(width * rng.uniform(0.25, 0.45))
        top, left = int(rng.integers(6, height - tall - 4)), int(rng.integers(6, width - wide - 4))
        box[top : top + tall, left : left + wide] = _sheet(rng, (tall, wide))


def _sheet(rng: Rng, shape: tuple[int, int]) -> Floats32:
    """A sheet of paper: a picture, or a heading over lines of type and a bar code."""
    height, width = shape
    if rng.random() < 0.25 and min(shape) > 60:
        print_ = cv2.resize(poster(rng, (128, 128)), shape[::-1], interpolation=cv2.INTER_AREA)
        return np.asarray(print_, dtype=np.float32)
    sheet = np.full(shape, rng.uniform(0.75, 0.95), np.float32)
    sheet[4 : 4 + max(2, height // 9), 4 : int(width * rng.uniform(0.4, 0.8))] = 0.1
    for row in range(8 + height // 8, height - 8, 5):
        start = 4
        while start < width - 6:  # words of a line, so that it breaks up as type does
            stop = min(start + int(rng.integers(4, 16)), width - 5)
            sheet[row : row + 2, start:stop] = rng.uniform(0.35, 0.6)
            start = stop + 3
    if height > 40 and rng.random() < 0.5:
        bars = rng.random(width // 4) < 0.5
        sheet[-16:-5, 4 : 4 + 2 * len(bars)] = np.where(np.repeat(bars, 2), 0.08, 0.9)
    return sheet


def _text(
    image: Floats32, text: str, centre: tuple[float, float], reach: tuple[float, float], ink: float
) -> None:
    """Print text as large as fits a width and height about a centre."""
    font, thick = cv2.FONT_HERSHEY_DUPLEX, max(2, int(reach[1] / 14))
    (width, height), _ = cv2.getTextSize(text, font, 1.0, 1)
    scale = min(reach[0] / width, reach[1] / height)
    at = (int(centre[0] - scale * width / 2), int(centre[1] + scale * height / 2))
    layer = np.zeros(image.shape, np.uint8)  # OpenCV 5 writes text on 8-bit images only
    cv2.putText(layer, text, at, font, scale, 255, thick, cv2.LINE_AA)
    image += (ink - image) * (layer / np.float32(255))
