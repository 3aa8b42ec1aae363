"""`vo calibrate`: calibration from a recording of a chessboard or ChArUco board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import ConfigError
from vo.cli.calibrate_options import Request
from vo.cli.calibrate_recording import (
    check_outputs,
    open_recording,
    search_progress,
)
from vo.cli.echo import echo, echo_json
from vo.cli.flags import in_flags
from vo.cli.stopping import interrupts_named

if TYPE_CHECKING:
    from vo.tools.calibrating.board import Board
    from vo.tools.calibrating.calibrate import CalibrationResult


def calibrate_command(request: Request) -> None:
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
    if request.imu_noise:
        from vo.cli.calibrate_imu_noise import calibrate_imu_noise

        calibrate_imu_noise(request)
        return
    from vo.tools.calibrating.board import make_board

    given, source = request.board, request.source
    made = make_board(
        given.board.value,
        given.columns,
        given.rows,
        given.square,
        given.marker,
        given.dictionary,
        given.legacy,
    )
    from vo.outputs.results.output_paths import refuse_existing

    output = request.output or Path("calibration.yaml")
    refuse_existing([request.print_board, None if source is None else output], force=request.force)
    if request.print_board is not None:
        _print_board(request.print_board, made)
        if source is None:
            if request.printing.json_output:
                echo_json({"board": str(made), "output": str(request.print_board)})
            return
    if source is None:
        raise ConfigError("give a recording of the board, or --print-board FILE to make a board")
    if request.imu:
        from vo.cli.calibrate_imu import calibrate_imu

        calibrate_imu(request, source, made, output)
    elif request.calibration is not None:
        raise ConfigError("--calibration gives the cameras for --imu; leave it out, or add --imu")
    else:
        _calibrate_cameras(request, source, made, output)


def _calibrate_cameras(request: Request, source: Path, board: Board, output: Path) -> None:
    from vo.cli.calibrate_table import print_result
    from vo.tools.calibrating.advice import warnings_of
    from vo.tools.calibrating.calibration_figures import to_dict

    printing, picture = request.printing, request.picture
    check_outputs([source], output, picture)
    with interrupts_named(output):
        result = _calibrate(request, source, board)
    _write(result, output, picture)
    written = None if picture is None else str(picture)
    printing.show(
        lambda: to_dict(result) | {"output": str(output), "picture": written},
        lambda: print_result(result, output, picture),
    )
    if printing.quiet and not printing.json_output:
        for line in warnings_of(result):
            echo(f"warning: {line}", err=True)


def _print_board(path: Path, board: Board) -> None:
    from vo.tools.calibrating.printing import save_board

    save_board(path, board)
    echo(f"{path}: {board}; print at 100 % and measure a square", err=True)


def _calibrate(request: Request, path: Path, board: Board) -> CalibrationResult:
    from vo.tools.calibrating.recorded import calibrate_recorded

    frames = request.frames
    with request.printing.warnings():
        source = open_recording(path, request)
        return calibrate_recorded(
            source,
            board,
            (frames.start, frames.end),
            model=request.model.value,
            look_at=request.look_at,
            views=request.views,
            progress=lambda total: search_progress(request.printing.errors, total),
        )


def _write(result: CalibrationResult, output: Path, picture: Path | None) -> None:
    from vo.recordings.formats.calibration import write_calibration
    from vo.tools.calibrating.calibration_figures import comments

    if picture is not None:
        from vo.tools.calibrating.plots import save_plot

        save_plot(picture, result)
    write_calibration(output, result.rig, in_flags(comments(result)))
