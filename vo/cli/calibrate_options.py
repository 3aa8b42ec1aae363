"""Options of `vo calibrate`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from vo.base.printable import counted
from vo.cli import options
from vo.cli.blocks import Only, argument, block, option

if TYPE_CHECKING:
    from rich.console import Console

# Headings of the options in `--help`, besides those in `options`.
_BOARD, _ESTIMATION, _INERTIAL = "Board", "Estimation", "Inertial sensor"


class BoardKind(StrEnum):
    """Choices of `--board`."""

    CHESSBOARD = "chessboard"
    CHARUCO = "charuco"


class Model(StrEnum):
    """Choices of `--model`."""

    AUTO = "auto"
    RADTAN = "radtan"
    RADTAN8 = "radtan8"
    EQUIDISTANT = "equidistant"


@block(_BOARD)
class BoardOptions:
    """The board."""

    board: BoardKind = option("Kind of board.", default=BoardKind.CHESSBOARD)
    columns: int = option(
        "Inner corners in a row: squares minus one.", default=9, metavar="N", min=1
    )
    rows: int = option(
        "Inner corners in a column: squares minus one.", default=6, metavar="N", min=1
    )
    square: float = option("Measured side of a square.", default=0.03, metavar="METRES")
    marker: float | None = option(
        "Side of a ChArUco marker.", default=None, metavar="METRES", show_default="0.75 squares"
    )
    dictionary: str = option("Dictionary of the ChArUco markers.", default="4X4_50", metavar="NAME")
    legacy: bool = option("ChArUco layout of OpenCV before 4.6.", "--legacy", default=False)


@block(_ESTIMATION)
class Request:
    """Arguments and options of the command."""

    source: Path | None = argument(
        "Recording of the board, in any format of `vo run`; no calibration is needed.",
        default=None,
        metavar="RECORDING",
        show_default=False,
    )
    output: Path | None = option(
        "Calibration file to write.",
        "--output",
        "-o",
        default=None,
        metavar="FILE",
        show_default="calibration.yaml, or imu.yaml with --imu-noise",
        panel=options.OUTPUT,
    )
    board: BoardOptions
    model: Model = option("Lens model. auto: the simplest that fits.", default=Model.AUTO)
    reading: Annotated[
        options.Reading, Only("mode", "format", "topic", "right_offset", "side_by_side")
    ]
    frames: Annotated[options.Frames, Only("start", "end")]
    look_at: int = option(
        "Largest number of frames to search, those with the least motion.",
        default=400,
        min=1,
        metavar="N",
    )
    views: int = option(
        "Largest number of views to use, the most different ones.", default=60, min=3, metavar="N"
    )
    picture: Path | None = option(
        "Plot coverage, residuals and errors to this .png, .pdf or .svg file.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    print_board: Path | None = option(
        "Write a board to print in true size: .pdf, .png or .svg.",
        default=None,
        metavar="FILE",
        panel=_BOARD,
    )
    imu: bool = option(
        "Calibrate pose and time offset of an inertial sensor too: turn the camera "
        "quickly about all axes, with the board in view.",
        "--imu",
        default=False,
        panel=_INERTIAL,
    )
    calibration: Path | None = option(
        "With --imu: the cameras, calibrated before; else they are calibrated from the "
        "same recording.",
        default=None,
        metavar="FILE",
        panel=_INERTIAL,
    )
    imu_noise: bool = option(
        "Measure the noise of an inertial sensor instead, from a recording at rest: at "
        "least a minute, better an hour.",
        "--imu-noise",
        default=False,
        panel=_INERTIAL,
    )
    force: bool = option(
        "Replace an existing file.", "--force", default=False, panel=options.OUTPUT
    )
    printing: options.Printing


def board_words(request: Request) -> Any:
    """The board, in the words of `vo.calibrate`."""
    return vars(request.board) | {"board": request.board.board.value}


def recording_words(request: Request) -> Any:
    """Board and recording, in the words of `vo.calibrate`."""
    reading = request.reading.keywords
    reading.pop("calibration", None)
    return board_words(request) | {
        **reading,
        "side_by_side": request.reading.side_by_side,
        "start": request.frames.start,
        "end": request.frames.end,
        "model": request.model.value,
        "views": request.views,
        "progress": lambda total: _search_progress(request.printing.errors, total),
    }


@contextmanager
def _search_progress(console: Console, total: int) -> Iterator[Callable[[int, int], None]]:
    """A callback with the numbers of frames searched and of views."""
    from vo.cli.progress import counting

    with counting(console, "searching for the board", total) as step:
        yield lambda done, found: step(counted(found, "view"), done)
