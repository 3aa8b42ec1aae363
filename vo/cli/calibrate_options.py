"""Options of `vo calibrate`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options
from vo.cli.blocks import Only

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


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """The board."""

    board: Annotated[BoardKind, typer.Option(help="Kind of board.", rich_help_panel=_BOARD)] = (
        BoardKind.CHESSBOARD
    )
    columns: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Inner corners in a row: squares minus one.",
            min=1,
            rich_help_panel=_BOARD,
        ),
    ] = 9
    rows: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Inner corners in a column: squares minus one.",
            min=1,
            rich_help_panel=_BOARD,
        ),
    ] = 6
    square: Annotated[
        float,
        typer.Option(metavar="METRES", help="Measured side of a square.", rich_help_panel=_BOARD),
    ] = 0.03
    marker: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Side of a ChArUco marker.",
            show_default="0.75 squares",
            rich_help_panel=_BOARD,
        ),
    ] = None
    dictionary: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="Dictionary of the ChArUco markers.", rich_help_panel=_BOARD
        ),
    ] = "4X4_50"
    legacy: Annotated[
        bool,
        typer.Option(
            "--legacy", help="ChArUco layout of OpenCV before 4.6.", rich_help_panel=_BOARD
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class Request:
    """Arguments and options of the command."""

    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="RECORDING",
            help="Recording of the board, in any format of `vo run`; no calibration is needed.",
            show_default=False,
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Calibration file to write.",
            show_default="calibration.yaml, or imu.yaml with --imu-noise",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    board: BoardOptions
    model: Annotated[
        Model,
        typer.Option(help="Lens model. auto: the simplest that fits.", rich_help_panel=_ESTIMATION),
    ] = Model.AUTO
    reading: Annotated[
        options.Reading, Only("mode", "format", "topic", "right_offset", "side_by_side")
    ]
    frames: Annotated[options.Frames, Only("start", "end")]
    look_at: Annotated[
        int,
        typer.Option(
            min=1,
            metavar="N",
            help="Largest number of frames to search, those with the least motion.",
            rich_help_panel=_ESTIMATION,
        ),
    ] = 400
    views: Annotated[
        int,
        typer.Option(
            min=3,
            metavar="N",
            help="Largest number of views to use, the most different ones.",
            rich_help_panel=_ESTIMATION,
        ),
    ] = 60
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Plot coverage, residuals and errors to this .png, .pdf or .svg file.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    print_board: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a board to print in true size: .pdf, .png or .svg.",
            rich_help_panel=_BOARD,
        ),
    ] = None
    imu: Annotated[
        bool,
        typer.Option(
            "--imu",
            help="Calibrate pose and time offset of an inertial sensor too: turn the camera "
            "quickly about all axes, with the board in view.",
            rich_help_panel=_INERTIAL,
        ),
    ] = False
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration",
            metavar="FILE",
            help="With --imu: the cameras, calibrated before; else they are calibrated from the "
            "same recording.",
            rich_help_panel=_INERTIAL,
        ),
    ] = None
    imu_noise: Annotated[
        bool,
        typer.Option(
            "--imu-noise",
            help="Measure the noise of an inertial sensor instead, from a recording at rest: at "
            "least a minute, better an hour.",
            rich_help_panel=_INERTIAL,
        ),
    ] = False
    force: Annotated[
        bool,
        typer.Option("--force", help="Replace an existing file.", rich_help_panel=options.OUTPUT),
    ] = False
    printing: options.Printing
