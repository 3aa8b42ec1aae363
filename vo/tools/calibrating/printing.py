"""Printable boards in true size."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Bytes
from vo.tools.calibrating.board import Board
from vo.tools.drawing import check_plot, saved_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_METRES_PER_INCH = 0.0254
_DPI = 300
_PIXELS_PER_SQUARE = 80


@contextmanager
def printed_page(path: Path, width_m: float, height_m: float, what: str) -> Iterator[Figure]:
    """A figure of this size, written when the block ends.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    check_plot(path, "file", what)
    width, height = width_m / _METRES_PER_INCH, height_m / _METRES_PER_INCH
    with saved_figure(path, width, height, dpi=_DPI, layout=None) as figure:
        yield figure


def save_board(path: Path | str, board: Board) -> None:
    """Write a board with a white margin of one square, to be printed at 100 %.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    across, down = board.columns + 3, board.rows + 3
    square = board.square_m
    with printed_page(Path(path), across * square, down * square, "printed boards") as figure:
        axes = figure.add_axes((1 / across, 1 / down, 1 - 2 / across, 1 - 2 / down))
        axes.imshow(draw_board(board), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_axis_off()
        size = min(0.25 * square / _METRES_PER_INCH * 72, 14)
        figure.text(0.5, 0.4 / down, _legend(board), ha="center", va="center", size=size)


def draw_board(board: Board, per_square: int = _PIXELS_PER_SQUARE) -> Bytes:
    """Image of the squares without a margin, `per_square` pixels each."""
    size = ((board.columns + 1) * per_square, (board.rows + 1) * per_square)
    if board.kind == "charuco":
        return np.asarray(board.charuco().generateImage(size, marginSize=0), dtype=np.uint8)
    row, column = np.indices((size[1], size[0])) // per_square
    return np.where((row + column) % 2 == 0, 0, 255).astype(np.uint8)


def _legend(board: Board) -> str:
    options = f"--columns {board.columns} --rows {board.rows} --square {board.square_m:g}"
    if board.kind == "charuco":
        options += f" --marker {board.marker_m:g} --dictionary {board.dictionary}"
    return f"vo calibrate --board {board.kind} {options}"
