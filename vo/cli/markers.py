"""`vo markers`: ArUco and AprilTag markers, boards, and their poses."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options
from vo.cli.blocks import Only, argument, block, option

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


@block(_BOARD)
class BoardOptions:
    """`--board` and its dimensions."""

    board: BoardChoice | None = option(
        "The markers are a board: a grid of markers, or a ChArUco board.",
        default=None,
        show_default="single markers",
    )
    columns: int = option(
        "Markers in a row of a grid, or inner corners in a row.", default=9, metavar="N", min=1
    )
    rows: int = option(
        "Markers in a column of a grid, or inner corners in a column.",
        default=6,
        metavar="N",
        min=1,
    )
    body: Path | None = option(
        "The markers are on a rigid body, such as a cube: their poses, in YAML, JSON or "
        "markers.csv as a map of markers (docs/markers.md).",
        default=None,
        metavar="FILE",
    )
    gap: float = option("Space between markers of a grid.", default=0.01, metavar="METRES")
    square: float = option("Side of a square of a ChArUco board.", default=0.03, metavar="METRES")


@block(_MARKERS)
class Request:
    """What to search, and where."""

    source: str | None = argument(
        "An image, RECORDING:NUMBER for a frame, or a recording in any format of vo run.",
        default=None,
        metavar="SOURCE",
        show_default=False,
    )
    length: float | None = option(
        "Side of the black square, for poses.",
        default=None,
        metavar="METRES",
        show_default="no poses",
    )
    dictionary: str = option(
        "Dictionary, such as tag36h11, tagStandard41h12, 4X4_50 or DICT_6X6_250; auto: the one "
        "that the images show.",
        default="auto",
        metavar="NAME",
    )
    refinement: RefinementChoice = option(
        "Corners by lines along the sides (most accurate), or by OpenCV's methods.",
        default=RefinementChoice.LINES,
    )
    board: BoardOptions
    reading: Annotated[options.Reading, Only("calibration", "format", "topic")]
    frames: options.Frames
    sheet: Path | None = option(
        "Write markers, or the board of --board, to print in true size: .pdf, .png or .svg.",
        "--print",
        default=None,
        metavar="FILE",
        panel=_SHEET,
    )
    ids: str = option(
        "Markers of the sheet, such as 0-3,7.", default="0", metavar="IDS", panel=_SHEET
    )
    force: bool = option("Replace an existing sheet.", "--force", default=False, panel=_SHEET)
    picture: Path | None = option(
        "Draw outlines, ids and axes to this .png or .jpg file; of a recording, of the "
        "frame with most markers.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    video: Path | None = option(
        "Draw the same into all frames of a recording, to this .mp4 file.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    csv: Path | None = option(
        "Also write a row for each marker in each frame.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )

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
