"""`vo calibrate`: calibration from a recording of a chessboard or ChArUco board."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from vo.base.errors import ConfigError, OutputError
from vo.cli import calibrate_options as choices
from vo.cli import options
from vo.cli.calibrate_progress import search_progress
from vo.cli.echo import echo, echo_json

if TYPE_CHECKING:
    from vo.tools.calibrating.board import Board
    from vo.tools.calibrating.calibrate import CalibrationResult


_MAX_GROUP = 10
"""Largest number of frames read for each frame searched."""


def calibrate_command(
    source: choices.Recording = None,
    output: choices.Output = None,
    board: choices.Kind = choices.BoardKind.CHESSBOARD,
    columns: choices.Columns = 9,
    rows: choices.Rows = 6,
    square: choices.Square = 0.03,
    marker: choices.Marker = None,
    dictionary: choices.Dictionary = "4X4_50",
    legacy: choices.Legacy = False,
    model: choices.LensChoice = choices.Model.AUTO,
    mode: options.Mode = options.ModeChoice.AUTO,
    format: options.Format = None,
    topic: options.Topics = None,
    right_offset: options.RightOffset = None,
    side_by_side: options.SideBySide = False,
    start: options.Start = 0,
    end: options.End = None,
    look_at: choices.LookAt = 400,
    views: choices.Views = 60,
    picture: choices.Picture = None,
    print_board: choices.PrintBoard = None,
    imu: choices.Imu = False,
    calibration: choices.Cameras = None,
    imu_noise: choices.ImuNoise = False,
    force: choices.Force = False,
    json_output: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Calibrate one or two cameras from a recording of a chessboard or ChArUco board.

    Make a board, print it at 100 % and glue it onto something flat:

      vo calibrate --print-board board.pdf --board charuco --columns 9 --rows 6 --square 0.025

    Calibrate from a recording of it, near and far, tilted, in all parts of the image:

      vo calibrate board.mcap --board charuco --columns 9 --rows 6 --square 0.025

    Use the result:

      vo run walk.mcap --calibration calibration.yaml -o out

    Calibrate an inertial sensor too, from a recording in which the camera is turned quickly:

      vo calibrate --imu swing.mcap --board charuco --columns 9 --rows 6 --square 0.025

    Measure the noise of an inertial sensor that lies still:

      vo calibrate --imu-noise rest.mcap -o imu.yaml --picture allan.png
    """
    from vo.tools.calibrating.board import make_board

    topics = tuple(topic or ())
    if imu_noise:
        _measure_noise(source, output, picture, force, format, topics, json_output, quiet)
        return
    output = output or Path("calibration.yaml")

    made = make_board(board.value, columns, rows, square, marker, dictionary, legacy)
    _refuse_existing([print_board, None if source is None else output], force)
    if print_board is not None:
        _print_board(print_board, made)
        if source is None:
            if json_output:
                echo_json({"board": str(made), "output": str(print_board)})
            return
    if source is None:
        raise ConfigError("give a recording of the board, or --print-board FILE to make a board")
    offset_ns = options.offset_ns(right_offset)
    request = Request(
        source,
        format,
        mode,
        topics,
        offset_ns,
        side_by_side,
        start,
        end,
        look_at,
        model.value,
        views,
        quiet,
    )
    if imu:
        _calibrate_imu(request, made, output, calibration, force, json_output)
        return
    if calibration is not None:
        raise ConfigError("--calibration gives the cameras for --imu; leave it out, or add --imu")
    result = _calibrate_and_write(request, made, output, picture)
    if json_output:
        from vo.tools.calibrating.report import to_dict

        written = None if picture is None else str(picture)
        echo_json(to_dict(result) | {"output": str(output), "picture": written})
    elif quiet:
        from vo.tools.calibrating.advice import warnings_of

        for line in warnings_of(result):
            echo(f"warning: {line}", err=True)
    else:
        from vo.cli.calibrate_table import print_result

        print_result(result, output, picture)


def _measure_noise(
    source: Path | None,
    output: Path | None,
    picture: Path | None,
    force: bool,
    format: str | None,
    topics: tuple[str, ...],
    as_json: bool,
    quiet: bool,
) -> None:
    from vo.cli.calibrate_imu_noise import calibrate_imu_noise
    from vo.outputs.results.output_paths import refuse_to_overwrite

    if source is None:
        raise ConfigError("give a recording of the inertial sensor at rest")
    output = output or Path("imu.yaml")
    _refuse_existing([output], force)
    refuse_to_overwrite([source], [output, picture])
    _check_outputs(output, picture)
    calibrate_imu_noise(
        source, output, picture, format=format, topics=topics, as_json=as_json, quiet=quiet
    )


def _refuse_existing(paths: Sequence[Path | None], force: bool) -> None:
    for path in paths:
        if path is not None and path.is_file() and not force:
            raise OutputError(f"{path} exists already; choose another file, or replace it: --force")


def _print_board(path: Path, board: Board) -> None:
    from vo.tools.calibrating.printing import save_board

    save_board(path, board)
    echo(f"{path}: {board}; print at 100 % and measure a square", err=True)


def _calibrate_imu(
    request: Request,
    board: Board,
    output: Path,
    calibration: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    from vo.cli.calibrate_imu import KALIBR_NAME, calibrate_imu
    from vo.outputs.results.output_paths import refuse_to_overwrite

    kalibr = output.with_name(KALIBR_NAME)
    _refuse_existing([kalibr], force)
    refuse_to_overwrite([request.path], [output, kalibr])
    _check_outputs(output, None)
    try:
        calibrate_imu(request, board, output, calibration, as_json=as_json)
    except KeyboardInterrupt:
        echo(f"interrupted; {output} was not written", err=True)
        raise typer.Exit(130) from None


class Request(NamedTuple):
    """The recording to calibrate from, and the choice of its frames and views."""

    path: Path
    format: str | None
    mode: options.ModeChoice
    topics: tuple[str, ...]
    right_offset_ns: int | None
    side_by_side: bool
    start: int
    end: int | None
    max_frames: int
    model: str
    max_views: int
    quiet: bool


def _calibrate_and_write(
    request: Request, board: Board, output: Path, picture: Path | None
) -> CalibrationResult:
    from vo.outputs.results.output_paths import refuse_to_overwrite

    refuse_to_overwrite([request.path], [output, picture])
    _check_outputs(output, picture)
    try:
        result = _calibrate(request, board)
    except KeyboardInterrupt:
        echo(f"interrupted; {output} was not written", err=True)
        raise typer.Exit(130) from None
    _write(result, output, picture)
    return result


def _calibrate(request: Request, board: Board) -> CalibrationResult:
    from vo.base.errors import CalibrationError
    from vo.cli.console import standard_error
    from vo.cli.progress import warnings_on
    from vo.recordings.sources.uncalibrated import open_uncalibrated
    from vo.tools.calibrating.calibrate import calibrate
    from vo.tools.calibrating.fit import MIN_VIEWS
    from vo.tools.calibrating.missing_board import explain_missing_board
    from vo.tools.calibrating.views import detect_views, least_motion_frames

    console = standard_error()
    path, format, mode, topics, offset_ns, side_by_side, start, end = request[:8]
    max_frames, model, max_views, quiet = request[8:]
    with warnings_on(console, quiet=quiet):
        source = open_uncalibrated(
            path,
            format=format,
            mode=mode.value,
            topics=topics,
            right_offset_ns=offset_ns,
            side_by_side=side_by_side,
        )
        count = max(min(end or len(source), len(source)) - start, 1)
        group_size = min(-(-count // max_frames), _MAX_GROUP)
        stride = -(-count // (max_frames * group_size))
        step = stride * group_size
        chosen = least_motion_frames(source.frames(start, end, stride), group_size)
        cameras = 2 if source.rig.is_stereo else 1
        with search_progress(standard_error(quiet=quiet), -(-count // step)) as progress:
            detected = detect_views(board, chosen, cameras, os.cpu_count() or 1, progress)
        if len(detected.views) < min(MIN_VIEWS, detected.frames / 2):
            frames = source.frames(start, end, step)
            raise CalibrationError(explain_missing_board(board, detected, frames))
        size = (source.rig.cam0.width, source.rig.cam0.height)
        return calibrate(board, detected, size, model, max_views)


def _check_outputs(output: Path, picture: Path | None) -> None:
    """Check the output paths before minutes of work."""
    for path in (output, picture):
        if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
            raise OutputError(f"{path} cannot be written; give a file in an existing folder")
    if picture is not None:
        from vo.tools.calibrating.plots import check_suffix

        check_suffix(picture)


def _write(result: CalibrationResult, output: Path, picture: Path | None) -> None:
    from vo.recordings.formats.calibration import write_calibration
    from vo.tools.calibrating.report import comments

    if picture is not None:
        from vo.tools.calibrating.plots import save_plot

        save_plot(picture, result)
    write_calibration(output, result.rig, comments(result))
