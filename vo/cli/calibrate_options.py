"""Options of `vo calibrate`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options

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


Recording = Annotated[
    Path | None,
    typer.Argument(
        metavar="RECORDING",
        help="Recording of the board, in any format of `vo run`; no calibration is needed.",
        show_default=False,
    ),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="Calibration file to write.",
        show_default="calibration.yaml, or imu.yaml with --imu-noise",
        rich_help_panel=options.OUTPUT,
    ),
]
Kind = Annotated[BoardKind, typer.Option(help="Kind of board.", rich_help_panel=_BOARD)]
Columns = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="Inner corners in a row: squares minus one.",
        min=1,
        rich_help_panel=_BOARD,
    ),
]
Rows = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="Inner corners in a column: squares minus one.",
        min=1,
        rich_help_panel=_BOARD,
    ),
]
Square = Annotated[
    float,
    typer.Option(metavar="METRES", help="Measured side of a square.", rich_help_panel=_BOARD),
]
Marker = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Side of a ChArUco marker.",
        show_default="0.75 squares",
        rich_help_panel=_BOARD,
    ),
]
Dictionary = Annotated[
    str,
    typer.Option(metavar="NAME", help="Dictionary of the ChArUco markers.", rich_help_panel=_BOARD),
]
Legacy = Annotated[
    bool,
    typer.Option("--legacy", help="ChArUco layout of OpenCV before 4.6.", rich_help_panel=_BOARD),
]
LensChoice = Annotated[
    Model,
    typer.Option(help="Lens model. auto: the simplest that fits.", rich_help_panel=_ESTIMATION),
]
LookAt = Annotated[
    int,
    typer.Option(
        min=1,
        metavar="N",
        help="Largest number of frames to search, those with the least motion.",
        rich_help_panel=_ESTIMATION,
    ),
]
Views = Annotated[
    int,
    typer.Option(
        min=3,
        metavar="N",
        help="Largest number of views to use, the most different ones.",
        rich_help_panel=_ESTIMATION,
    ),
]
Picture = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Plot coverage, residuals and errors to this .png, .pdf or .svg file.",
        rich_help_panel=options.OUTPUT,
    ),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace an existing file.", rich_help_panel=options.OUTPUT),
]
Imu = Annotated[
    bool,
    typer.Option(
        "--imu",
        help="Calibrate pose and time offset of an inertial sensor too: turn the camera quickly "
        "about all axes, with the board in view.",
        rich_help_panel=_INERTIAL,
    ),
]
Cameras = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="With --imu: the cameras, calibrated before; else they are calibrated from the same "
        "recording.",
        rich_help_panel=_INERTIAL,
    ),
]
ImuNoise = Annotated[
    bool,
    typer.Option(
        "--imu-noise",
        help="Measure the noise of an inertial sensor instead, from a recording at rest: at least "
        "a minute, better an hour.",
        rich_help_panel=_INERTIAL,
    ),
]
PrintBoard = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Write a board to print in true size: .pdf, .png or .svg.",
        rich_help_panel=_BOARD,
    ),
]
