"""Writer of the TUM RGB-D layout: one camera with depth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from data_synth.records import Imu, Recording, Shot
from data_synth.writers.encoding import SUFFIXES, tum_depth_png, write_images
from data_synth.writers.limits import check_tum
from data_synth.writers.tables import (
    numbers_text,
    seconds_text,
    write_lines,
    write_movers,
    written_stamps,
    written_truth,
)
from vo.base.errors import ConfigError
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.formats.trajectory import tum_line, write_tum


def write(path: Path, recording: Recording, shots: Iterator[Shot], codec: str) -> None:
    """Write `rgb/`, `depth/` (16 bits, 5000 per metre), their lists, the truth and calibration.

    `groundtruth.txt` has the poses of cam0 at the rate of the inertial sensor, `groundtruth.tum`
    those at the frames.

    Raises:
        ConfigError: there are two cameras or no depth.
        OSError: a file cannot be written.
        OutputError: the same, of the truth or the calibration.
    """
    check_tum(recording.rig, False)
    if not recording.has_depth:
        raise ConfigError(
            "format tum requires depth, but the recording has none; set depth to true"
        )
    for name in ("rgb", "depth"):
        (path / name).mkdir(parents=True)
    stamps = [seconds_text(stamp) for stamp in recording.stamps_ns[0].tolist()]
    suffix = SUFFIXES[codec]
    title = "rgb images" if recording.has_colour else "rgb images (grey)"
    _write_list(path / "rgb.txt", title, recording, "rgb", suffix)
    _write_list(path / "depth.txt", "depth images, 5000 a metre", recording, "depth", ".png")
    write_lines(path / "groundtruth.txt", _truth_lines(recording))
    write_tum(path / "groundtruth.tum", written_truth(recording))
    write_calibration(path / "calibration.yaml", recording.rig)
    write_movers(path / "movers.csv", recording)
    if recording.imu is not None:
        write_lines(path / "accelerometer.txt", _accelerometer_lines(recording.imu))
    write_images(
        shots,
        codec,
        lambda _, index: path / "rgb" / f"{stamps[index]}{suffix}",
        lambda index: path / "depth" / f"{stamps[index]}.png",
        tum_depth_png,
    )


def _write_list(path: Path, title: str, recording: Recording, folder: str, suffix: str) -> None:
    heading = [f"# {title}", f"# {recording.name}", "# timestamp filename"]
    stamps = map(seconds_text, written_stamps(recording, 0))
    write_lines(path, [*heading, *(f"{stamp} {folder}/{stamp}{suffix}" for stamp in stamps)])


def _truth_lines(recording: Recording) -> Iterator[str]:
    yield "# true poses of the camera in the world"
    yield f"# {recording.name}"
    yield "# timestamp tx ty tz qx qy qz qw"
    truth = recording.body_truth
    for stamp, pose in zip(truth.stamps_ns.tolist(), truth.world_from_body, strict=True):
        yield tum_line(stamp, pose @ recording.body_from_cam0)


def _accelerometer_lines(imu: Imu) -> Iterator[str]:
    yield "# specific force in m/s^2 along the axes of the body (x ahead, y left, z up)"
    yield "# timestamp ax ay az"
    for stamp, accel in zip(imu.stamps_ns.tolist(), imu.accel, strict=True):
        yield f"{seconds_text(stamp)} {numbers_text(accel, ' ')}"
