"""`vo calibrate --imu`: pose and time offset of an inertial sensor on the camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vo.cli.calibrate_options import recording_words
from vo.cli.echo import echo, echo_json
from vo.cli.stopping import interrupts_named

if TYPE_CHECKING:
    from vo.cli.calibrate_options import Request
    from vo.tools.calibrating.imu_camera import ImuOnCamera


def calibrate_imu(request: Request, source: Path, output: Path) -> None:
    """Calibrate, write our own and Kalibr's file, and print the result."""
    from vo.api.calibration import calibrate_imu as calibrate
    from vo.tools.calibrating.imu_camera import warnings_of

    printing, words = request.printing, recording_words(request)
    with interrupts_named(output), printing.warnings():
        result = calibrate(
            source, output, calibration=request.calibration, force=request.force, **words
        )
    found, kalibr = result.found, result.kalibr
    warnings = warnings_of(found)
    if printing.json_output:
        written = None if kalibr is None else str(kalibr)
        facts = _facts(found) | {"warnings": warnings, "output": str(output), "kalibr": written}
        echo_json(facts)
        return
    if not printing.quiet:
        _print(found)
    for line in warnings:
        echo(f"warning: {line}", err=True)
    if not printing.quiet:
        echo(f"calibration: {output}")
        without = f"not in Kalibr's layout: {result.not_for_kalibr}"
        echo(without if kalibr is None else f"in Kalibr's layout: {kalibr}")


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
