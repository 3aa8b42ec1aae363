"""`vo calibrate`: cameras from a recording of a chessboard or ChArUco board."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vo.cli.run import ModeChoice
from vo.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

    from vo.calibrating.board import Board
    from vo.calibrating.calibrate import Result


_MOST_TO_CHOOSE_FROM = 10
"""Frames that are read for each that is looked at."""


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


def calibrate_command(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="RECORDING",
            help="Any recording that vo run takes, of the board; a calibration is not needed.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="File for the calibration.")
    ] = Path("calibration.yaml"),
    board: Annotated[BoardKind, typer.Option(help="Kind of the board.")] = BoardKind.CHESSBOARD,
    columns: Annotated[
        int, typer.Option(metavar="N", help="Inner corners in a row: squares less one.", min=1)
    ] = 9,
    rows: Annotated[
        int, typer.Option(metavar="N", help="Inner corners in a column: squares less one.", min=1)
    ] = 6,
    square: Annotated[
        float, typer.Option(metavar="METRES", help="Side of a square, measured.")
    ] = 0.03,
    marker: Annotated[
        float | None,
        typer.Option(
            metavar="METRES", help="Side of a ChArUco marker.", show_default="0.75 squares"
        ),
    ] = None,
    dictionary: Annotated[
        str, typer.Option(metavar="NAME", help="Dictionary of the ChArUco markers.")
    ] = "4X4_50",
    legacy: Annotated[
        bool, typer.Option("--legacy", help="A ChArUco board as made by OpenCV before 4.6.")
    ] = False,
    model: Annotated[
        Model, typer.Option(help="Lens; auto compares them and takes the simplest that fits.")
    ] = Model.AUTO,
    mode: Annotated[
        ModeChoice, typer.Option(help="mono calibrates the left camera alone.")
    ] = ModeChoice.AUTO,
    format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Of the recording, as for `vo run`.",
            show_default="found out from its files",
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOPIC",
            help="Camera of a log, as for `vo run`; may be given again.",
            show_default="found out from the names",
        ),
    ] = None,
    start: Annotated[
        int, typer.Option(min=0, metavar="N", help="First frame, counted from 0.")
    ] = 0,
    end: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Frame to stop before.", show_default="the last"),
    ] = None,
    look_at: Annotated[
        int,
        typer.Option(
            min=1,
            metavar="N",
            help="Most frames to look for the board in, the stillest.",
        ),
    ] = 400,
    views: Annotated[
        int,
        typer.Option(min=3, metavar="N", help="Most views to calibrate with, the most different."),
    ] = 60,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw coverage, residuals and errors: .png, .pdf or .svg."
        ),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print JSON for machines instead of a table.")
    ] = False,
    print_board: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write the board for printing, in true size: .pdf, .png or .svg."
        ),
    ] = None,
) -> None:
    """Calibrate one camera or two from a recording of a chessboard or ChArUco board.

    Make a board, print it at 100 % and glue it onto something flat:

      vo calibrate --print-board board.pdf --board charuco --columns 9 --rows 6 --square 0.025

    Record it from near and far, tilted every way, in all parts of the image:

      vo calibrate board.mcap --board charuco --columns 9 --rows 6 --square 0.025

      vo run walk.mcap --calibration calibration.yaml -o out
    """
    from vo.calibrating.board import make_board

    known = make_board(board.value, columns, rows, square, marker, dictionary, legacy)
    if print_board is not None:
        from vo.calibrating.printing import save_board

        save_board(print_board, known)
        typer.echo(f"{print_board}: {known}; print at 100 % and measure a square", err=True)
        if source is None:
            return
    if source is None:
        raise ConfigError("give a recording of the board, or --print-board FILE to make one")
    _check_outputs(output, picture)
    opening, frames = (format, mode, topic or []), (start, end, look_at)
    try:
        result = _calibrate(source, known, opening, frames, model.value, views)
    except KeyboardInterrupt:
        typer.echo(f"interrupted; {output} was not written", err=True)
        raise typer.Exit(130) from None
    _write(result, output, picture)
    if json_output:
        import json

        from vo.calibrating.report import to_dict

        typer.echo(json.dumps(to_dict(result), indent=2, allow_nan=False))
    else:
        from vo.cli.calibrate_table import print_result

        print_result(result, output, picture)


def _calibrate(
    path: Path,
    board: Board,
    opening: tuple[str | None, ModeChoice, list[str]],
    frames: tuple[int, int | None, int],
    model: str,
    views: int,
) -> Result:
    from rich.console import Console

    from vo.calibrating.calibrate import calibrate
    from vo.calibrating.fit import FEWEST_VIEWS
    from vo.calibrating.missing import why_not_found
    from vo.calibrating.survey import stillest, survey
    from vo.cli.progress import warnings_on
    from vo.errors import CalibrationError
    from vo.sources.uncalibrated import open_uncalibrated

    console = Console(stderr=True, highlight=False)
    with warnings_on(console):
        format, mode, topics = opening
        source = open_uncalibrated(path, format=format, mode=mode.value, topics=topics)
        start, end, most = frames
        count = max(min(end or len(source), len(source)) - start, 1)
        of = min(-(-count // most), _MOST_TO_CHOOSE_FROM)
        stride = -(-count // (most * of))
        chosen = stillest(source.frames(start, end, stride), of)
        cameras = 2 if source.rig.is_stereo else 1
        with _bar(console, -(-count // (stride * of))) as progress:
            found = survey(board, chosen, cameras, os.cpu_count() or 1, progress)
        if len(found.views) < min(FEWEST_VIEWS, found.frames / 2):
            every = stride * of
            raise CalibrationError(why_not_found(board, found, source.frames(start, end, every)))
        size = (source.rig.cam0.width, source.rig.cam0.height)
        return calibrate(board, found, size, model, views)


@contextmanager
def _bar(console: Console, total: int) -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal, elsewhere nothing; told how many were looked at and show the board."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[found]}"),
        console=console,
        transient=True,
        disable=not console.is_terminal,
        expand=True,
    ) as bar:
        task = bar.add_task("looking for the board", total=total, found="")
        yield lambda done, found: bar.update(task, completed=done, found=f"{found} show it")


def _check_outputs(output: Path, picture: Path | None) -> None:
    """Before minutes of work, not after them."""
    for path in (output, picture):
        if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
            raise OutputError(f"{path} cannot be written: give a file in a folder that exists")
    if picture is not None:
        from vo.calibrating.picture import check_suffix

        check_suffix(picture)


def _write(result: Result, output: Path, picture: Path | None) -> None:
    from vo.calibrating.report import comments
    from vo.formats.calibration import write_calibration

    if picture is not None:
        from vo.calibrating.picture import save_picture

        save_picture(picture, result)
    write_calibration(output, result.rig, comments(result))
