"""`vo calibrate`: calibration from a recording of a chessboard or ChArUco board."""

from __future__ import annotations

from pathlib import Path

from vo.base.errors import ConfigError
from vo.cli.calibrate_options import Request, board_words, recording_words
from vo.cli.echo import echo, echo_json
from vo.cli.flags import in_flags
from vo.cli.stopping import interrupts_named


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
    from vo.outputs.results.output_paths import refuse_existing

    source, output = request.source, request.output or Path("calibration.yaml")
    refuse_existing([request.print_board, None if source is None else output], force=request.force)
    if request.print_board is not None:
        _print_board(request, request.print_board)
    if source is None:
        if request.print_board is None:
            raise ConfigError(
                "give a recording of the board, or --print-board FILE to make a board"
            )
    elif request.imu:
        from vo.cli.calibrate_imu import calibrate_imu

        calibrate_imu(request, source, output)
    elif request.calibration is not None:
        raise ConfigError("--calibration gives the cameras for --imu; leave it out, or add --imu")
    else:
        _calibrate_cameras(request, source, output)


def _print_board(request: Request, path: Path) -> None:
    from vo.api.calibration import print_board

    made = print_board(path, force=request.force, **board_words(request))
    echo(f"{path}: {made}; print at 100 % and measure a square", err=True)
    if request.source is None and request.printing.json_output:
        echo_json({"board": str(made), "output": str(path)})


def _calibrate_cameras(request: Request, source: Path, output: Path) -> None:
    from vo.api.calibration import calibrate, check_outputs
    from vo.cli.calibrate_table import print_result
    from vo.recordings.formats.calibration import write_calibration
    from vo.tools.calibrating.advice import warnings_of
    from vo.tools.calibrating.calibration_figures import comments, to_dict

    printing, picture = request.printing, request.picture
    check_outputs(source, [output], picture, force=request.force)
    with interrupts_named(output), printing.warnings():
        words = recording_words(request)
        result = calibrate(source, look_at=request.look_at, picture=picture, **words)
    write_calibration(output, result.rig, in_flags(comments(result)))
    written = None if picture is None else str(picture)
    printing.show(
        lambda: to_dict(result) | {"output": str(output), "picture": written},
        lambda: print_result(result, output, picture),
    )
    if printing.quiet and not printing.json_output:
        for line in warnings_of(result):
            echo(f"warning: {line}", err=True)
