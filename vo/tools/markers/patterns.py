"""What markers look like, cell by cell, and the codes of AprilTag's standard tags.

The corners of a standard tag are those of its inner white square; bits are in that square and in
a ring outside of the black one (Krogius et al., "Flexible layouts for fiducial tags", IROS 2019).
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from vo.base.types import Bytes, Floats, Ints
from vo.engine.markers.dictionaries import STANDARD, dictionary

_CELLS, _RIM, _BITS = 5, 2, 41  # of a standard tag: side of its square, what is around it, in cells


def outer_cells(name: str) -> int:
    """Width in cells of what a marker has outside of its square: 0, or 2 of standard tags."""
    return _RIM if name == STANDARD else 0


def square_cells(name: str) -> int:
    """Side in cells of the square whose corners are found."""
    return _CELLS if name == STANDARD else int(dictionary(name).markerSize) + 2


def square_colour(name: str) -> str:
    """Colour of that square."""
    return "white" if name == STANDARD else "black"


def marker_cells(name: str, number: int) -> Bytes:
    """All cells of a marker (N, N), 0 or 255."""
    if name != STANDARD:
        image = dictionary(name).generateImageMarker(number, square_cells(name))
        return np.asarray(image, dtype=np.uint8)
    cells = np.zeros((_CELLS + 2 * _RIM, _CELLS + 2 * _RIM), dtype=np.uint8)
    cells[_RIM:-_RIM, _RIM:-_RIM] = 255
    rows, columns = _bit_cells()
    bits = (int(_codes()[number]) >> np.arange(_BITS - 1, -1, -1)) & 1
    cells[rows, columns] = 255 * bits
    return cells


def standard_number(levels: Floats, most_wrong: int) -> tuple[int, int] | None:
    """Number of the standard tag with these grey levels of cells (9, 9), with some wrong bits.

    Also how often it is turned to the left by 90 degrees. None if it is none.
    """
    light, dark = (_plane(levels, ring) for ring in (2, 1))
    if (light <= dark).any():
        return None
    is_light = levels > 0.5 * (light + dark)
    weights = 1 << np.arange(_BITS - 1, -1, -1, dtype=np.int64)
    turned = [int(np.rot90(is_light, -k)[_bit_cells()] @ weights) for k in range(4)]
    wrong = np.bitwise_count(_codes()[None, :] ^ np.array(turned)[:, None])
    turns, number = np.unravel_index(int(np.argmin(wrong)), wrong.shape)
    if wrong[turns, number] > most_wrong:
        return None
    return int(number), int(turns)


def _plane(levels: Floats, ring: int) -> Floats:
    """Grey levels (9, 9) of the plane through those of a ring of cells: light may be uneven."""
    from_middle = np.arange(len(levels)) - len(levels) // 2
    y, x = np.meshgrid(from_middle, from_middle, indexing="ij")
    of_ring = np.maximum(np.abs(x), np.abs(y)) == len(levels) // 2 - ring
    # Of a ring around the middle, x, y and 1 are orthogonal.
    slopes = [(levels * of_ring * v).sum() / (of_ring * v * v).sum() for v in (x, y)]
    return np.asarray(levels[of_ring].mean() + slopes[0] * x + slopes[1] * y)


@lru_cache(maxsize=1)
def _bit_cells() -> tuple[Ints, Ints]:
    """Rows and columns (41,) of the bits, the most significant first: a quarter, turned, middle."""
    x, y = np.array([0, 1, 2, 3, 4, 5, 6, 7, 3, 4]), np.array([0] * 8 + [3, 3])
    columns: list[int] = []
    rows: list[int] = []
    for _ in range(4):
        columns, rows = [*columns, *x], [*rows, *y]
        x, y = 8 - y, x
    return np.array([*rows, 4]), np.array([*columns, 4])


@lru_cache(maxsize=1)
def _codes() -> Ints:
    text = (Path(__file__).parent / "standard41h12.txt").read_text("ascii")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return np.array([int(code, 16) for line in lines for code in line.split()], dtype=np.int64)
