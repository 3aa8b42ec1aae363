"""`vo calibrate --imu`: pose and time offset of an inertial sensor on the camera."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vo.cli.calibrate_recording import (
    check_outputs,
    open_recording,
    search_progress,
)
from vo.cli.echo import echo, echo_json
from vo.cli.stopping import interrupts_named

if TYPE_CHECKING:
    from vo.base.types import Rig
    from vo.cli.calibrate_options import Request
    from vo.recordings.formats.calibration import ImuCalibration
    from vo.tools.calibrating.board import Board
    from vo.tools.calibrating.imu_camera import ImuOnCamera

KALIBR_NAME = "camchain-imucam.yaml"
_MAX_FRAMES = 2000


def calibrate_imu(request: Request, source: Path, board: Board, output: Path) -> None:
    """Calibrate, write our own and Kalibr's file, and print the result."""
    from vo.outputs.results.output_paths import refuse_existing, refuse_to_overwrite
    from vo.recordings.formats.calibration import write_calibration
    from vo.tools.calibrating.imu_camera import comments, warnings_of
    from vo.tools.calibrating.kalibr_chain import write_chain

    kalibr, printing = output.with_name(KALIBR_NAME), request.printing
    refuse_existing([kalibr], force=request.force)
    refuse_to_overwrite([source], [kalibr])
    check_outputs([source], output, None)
    with interrupts_named(output), printing.warnings():
        rig, found, imu = _calibrate(request, source, board)
    write_calibration(output, rig, comments(found), imu)
    reason = write_chain(kalibr, rig, imu)
    warnings = warnings_of(found)
    if printing.json_output:
        written = None if reason else str(kalibr)
        facts = _facts(found) | {"warnings": warnings, "output": str(output), "kalibr": written}
        echo_json(facts)
        return
    if not printing.quiet:
        _print(found)
    for line in warnings:
        echo(f"warning: {line}", err=True)
    if not printing.quiet:
        echo(f"calibration: {output}")
        echo(f"not in Kalibr's layout: {reason}" if reason else f"in Kalibr's layout: {kalibr}")


def _calibrate(
    request: Request, path: Path, board: Board
) -> tuple[Rig, ImuOnCamera, ImuCalibration]:
    from vo.recordings.formats.calibration import ImuCalibration, read_calibration
    from vo.recordings.sources.imu import usable_noise
    from vo.recordings.sources.imu_only import open_imu
    from vo.tools.calibrating.board_poses import board_poses
    from vo.tools.calibrating.calibrate import calibrate
    from vo.tools.calibrating.imu_camera import calibrate_imu_camera
    from vo.tools.calibrating.views import detect_views

    sensor = open_imu(path, request.reading.format, request.reading.topics)
    samples = sensor.read()
    source = open_recording(path, request)
    calibration, start, end = request.calibration, request.frames.start, request.frames.end
    size = (source.rig.cam0.width, source.rig.cam0.height)
    given = None if calibration is None else read_calibration(calibration, size)
    count = max(min(end or len(source), len(source)) - start, 1)
    stride = -(-count // _MAX_FRAMES)
    cameras = 2 if source.rig.is_stereo and given is None else 1
    frames = source.frames(start, end, stride)
    with search_progress(request.printing.errors, -(-count // stride)) as progress:
        detected = detect_views(board, frames, cameras, os.cpu_count() or 1, progress)
    if given is None:
        rig = calibrate(board, detected, size, request.model.value, request.views).rig
        noise = usable_noise(sensor)
    else:
        rig, noise = given.rig, given.imu.noise or usable_noise(sensor)
    found = calibrate_imu_camera(
        board_poses(board, detected, rig.cam0),
        samples.stamps_ns,
        samples.gyro,
        samples.accel,
        noise,
    )
    return rig, found, ImuCalibration(found.cam0_from_imu, noise, found.time_offset_s)


def _facts(found: ImuOnCamera) -> dict[str, Any]:
    return {
        "cam0_from_imu": found.cam0_from_imu.tolist(),
        "rotation_sd_deg": found.rotation_sd_deg.tolist(),
        "translation_sd_m": found.translation_sd_m.tolist(),
        "time_offset_s": found.time_offset_s,
        "time_offset_sd_s": found.time_offset_sd_s,
        "gyro_bias": found.gyro_bias.tolist(),
        "accel_bias": found.accel_bias.tolist(),
        "views": found.views,
        "seconds": found.seconds,
        "corner_rms_px": found.corner_rms_px,
        "misfit": found.misfit,
    }


def _print(found: ImuOnCamera) -> None:
    place = ", ".join(
        f"{1e3 * value:.1f} ± {1e3 * sd:.1f}"
        for value, sd in zip(found.cam0_from_imu[:3, 3], found.translation_sd_m, strict=True)
    )
    echo(f"{found.views} views in {found.seconds:.1f} s, corners {found.corner_rms_px:.2f} px RMS")
    echo("cam0_from_imu")
    for row in found.cam0_from_imu[:3]:
        echo("  " + " ".join(f"{value:10.6f}" for value in row))
    echo(f"position      {place} mm")
    echo(f"rotation      ± {np.max(found.rotation_sd_deg):.3f} degrees")
    echo(
        f"time offset   {1e3 * found.time_offset_s:+.3f} ± {1e3 * found.time_offset_sd_s:.3f} ms, "
        "to be added to stamps of images"
    )
