"""Printable boards in true size."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.base.types import Bytes
from vo.tools.calibrating.board import Board

_SUFFIXES = (".pdf", ".png", ".svg")
_METRES_PER_INCH = 0.0254
_DPI = 300
_PIXELS_PER_SQUARE = 80


def save_board(path: Path | str, board: Board) -> None:
    """Write a board with a white margin of one square, to be printed at 100 %.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    require("matplotlib", extra="report", what="printed boards")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise OutputError(f"{path}: unsupported kind of file; use {', '.join(_SUFFIXES)}")
    across, down = board.columns + 3, board.rows + 3
    inches = board.square_m / _METRES_PER_INCH
    figure = Figure(figsize=(across * inches, down * inches), dpi=_DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((1 / across, 1 / down, 1 - 2 / across, 1 - 2 / down))
    axes.imshow(draw_board(board), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.set_axis_off()
    size = min(0.25 * inches * 72, 14)
    figure.text(0.5, 0.4 / down, _legend(board), ha="center", va="center", size=size)
    try:
        figure.savefig(path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


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
