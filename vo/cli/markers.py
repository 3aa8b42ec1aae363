"""`vo markers`: ArUco and AprilTag markers, boards, and their poses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options
from vo.cli.blocks import Only

_MARKERS, _BOARD, _SHEET = "Markers", "Board", "Sheet to print"


class BoardChoice(StrEnum):
    """Choices of `--board`."""

    GRID = "grid"
    CHARUCO = "charuco"


class RefinementChoice(StrEnum):
    """Choices of `--refinement`."""

    LINES = "lines"
    SUBPIX = "subpix"
    APRILTAG = "apriltag"
    NONE = "none"


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """`--board` and its dimensions."""

    board: Annotated[
        BoardChoice | None,
        typer.Option(
            "--board",
            help="The markers are a board: a grid of markers, or a ChArUco board.",
            show_default="single markers",
            rich_help_panel=_BOARD,
        ),
    ] = None
    columns: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            help="Markers in a row of a grid, or inner corners in a row.",
            rich_help_panel=_BOARD,
        ),
    ] = 9
    rows: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            help="Markers in a column of a grid, or inner corners in a column.",
            rich_help_panel=_BOARD,
        ),
    ] = 6
    gap: Annotated[
        float,
        typer.Option(
            metavar="METRES", help="Space between markers of a grid.", rich_help_panel=_BOARD
        ),
    ] = 0.01
    square: Annotated[
        float,
        typer.Option(
            metavar="METRES", help="Side of a square of a ChArUco board.", rich_help_panel=_BOARD
        ),
    ] = 0.03


@dataclass(frozen=True, kw_only=True)
class Request:
    """What to search, and where."""

    source: Annotated[
        str | None,
        typer.Argument(
            metavar="SOURCE",
            help="An image, RECORDING:NUMBER for a frame, or a recording in any format of vo run.",
            show_default=False,
        ),
    ] = None
    length: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Side of the black square, for poses.",
            show_default="no poses",
            rich_help_panel=_MARKERS,
        ),
    ] = None
    dictionary: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Dictionary, such as tag36h11, 4X4_50 or DICT_6X6_250; auto: the one that the "
            "images show.",
            rich_help_panel=_MARKERS,
        ),
    ] = "auto"
    refinement: Annotated[
        RefinementChoice,
        typer.Option(
            "--refinement",
            help="Corners by lines along the sides (most accurate), or by OpenCV's methods.",
            rich_help_panel=_MARKERS,
        ),
    ] = RefinementChoice.LINES
    board: BoardOptions
    reading: Annotated[options.Reading, Only("calibration", "format", "topic")]
    frames: options.Frames
    sheet: Annotated[
        Path | None,
        typer.Option(
            "--print",
            metavar="FILE",
            help="Write markers to print in true size: .pdf, .png or .svg.",
            rich_help_panel=_SHEET,
        ),
    ] = None
    ids: Annotated[
        str,
        typer.Option(
            metavar="IDS", help="Markers of the sheet, such as 0-3,7.", rich_help_panel=_SHEET
        ),
    ] = "0"
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw outlines, ids and axes to this .png or .jpg file; of a recording, of the "
            "frame with most markers.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            metavar="FILE",
            help="Also write a row for each marker in each frame.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None

    @property
    def target(self) -> str:
        """SOURCE, as text."""
        return self.source or ""


def markers_command(
    request: Request,
    printing: options.Printing,
) -> None:
    """Find ArUco and AprilTag markers, and their poses, in an image or a recording.

    A flat square allows two poses, mirrored at the line of sight; where the
    image cannot decide between them the pose is marked as ambiguous.

    Print two markers, at 100 %, and measure the black square:

      vo markers --print sheet.pdf --dictionary tag36h11 --ids 0,1 --length 0.16

    Find them in a photo, and draw their axes:

      vo markers photo.jpg --length 0.16 --calibration camera.yaml --picture found.png

    Poses over a recording, as a table of numbers:

      vo markers walk.mcap --length 0.16 --csv markers.csv

    Exit status: 0 a marker was found, 1 none, or an error, 2 wrong usage.
    """
    from vo.base.errors import ConfigError
    from vo.cli.markers_run import run_request, write_sheet
    from vo.cli.markers_table import print_markers

    if request.sheet is not None:
        write_sheet(request, is_json=printing.json_output and request.source is None)
        if request.source is None:
            return
    if request.source is None:
        raise ConfigError("give an image or a recording, or --print FILE to make a sheet")
    with printing.warnings():
        result = run_request(request, printing.errors)
    printing.show(result.to_dict, lambda: print_markers(result))
    if not any(frame.markers for frame in result.frames):
        raise typer.Exit(1)
