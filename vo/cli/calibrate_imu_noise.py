"""`vo calibrate --imu-noise`: noise of an inertial sensor from a recording at rest."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from vo.base.errors import ConfigError
from vo.cli.calibrate_options import Request
from vo.cli.echo import echo, echo_json

if TYPE_CHECKING:
    from vo.tools.calibrating.imu_noise import ImuNoiseResult, SensorNoise


def calibrate_imu_noise(request: Request) -> None:
    """Measure, write Kalibr's imu.yaml and perhaps a plot, and print the noise."""
    from vo.api.calibration import calibrate_imu_noise as measure
    from vo.tools.calibrating.imu_noise import warnings_of

    source, picture, printing = request.source, request.picture, request.printing
    if source is None:
        raise ConfigError("give a recording of the inertial sensor at rest")
    output = request.output or Path("imu.yaml")
    with printing.warnings():
        result = measure(
            source,
            output,
            picture=picture,
            format=request.reading.format,
            topics=request.reading.topics,
            force=request.force,
        )
    if printing.json_output:
        written = None if picture is None else str(picture)
        echo_json(_facts(result) | {"output": str(output), "picture": written})
        return
    if not printing.quiet:
        _print(result)
    for line in warnings_of(result):
        echo(f"warning: {line}", err=True)
    if not printing.quiet:
        echo(f"noise: {output}")
        if picture is not None:
            echo(f"picture: {picture}")


def _facts(result: ImuNoiseResult) -> dict[str, Any]:
    from vo.tools.calibrating.imu_noise import warnings_of

    return {
        "rate_hz": round(result.rate_hz, 6),
        "rest_s": round(result.rest_s, 3),
        "start_s": round(result.start_s, 3),
        "gyro": _terms(result.gyro),
        "accel": _terms(result.accel),
        "warnings": warnings_of(result),
    }


def _terms(sensor: SensorNoise) -> dict[str, Any]:
    terms = sensor.terms
    return {
        "noise": terms.density,
        "noise_sd": terms.density * terms.density_sd,
        "walk": sensor.walk,
        "walk_sd": terms.walk * terms.walk_sd if sensor.shows_walk else None,
        "bias_instability": terms.instability,
        "ramp": terms.ramp,
    }


def _print(result: ImuNoiseResult) -> None:
    echo(f"{result.rest_s:.0f} s at rest, {result.rate_hz:.4g} samples per second")
    rows = (("gyroscope", result.gyro, "rad/s"), ("accelerometer", result.accel, "m/s²"))
    for name, sensor, unit in rows:
        terms = sensor.terms
        walk = f"± {100 * terms.walk_sd:.0f} %" if sensor.shows_walk else "at most"
        echo(
            f"{name:<14}noise {terms.density:.3g} {unit}/√Hz (± {100 * terms.density_sd:.1f} %), "
            f"walk {sensor.walk:.3g} {unit}/s/√Hz ({walk})"
        )
