"""Writer of the EuRoC MAV layout."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from data_synth.records import BODY, Imu, Recording, Shot
from data_synth.writers.encoding import SUFFIXES, write_images
from data_synth.writers.tables import (
    write_imu,
    write_lines,
    write_movers,
    write_states,
    written_stamps,
    written_truth,
)
from vo.base.types import Floats
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.formats.trajectory import write_tum

_DISTORTION = {"none": "radial-tangential", "radtan": "radial-tangential"}
"""Names in EuRoC; other distortion models keep the names of our calibration format."""


def write(path: Path, recording: Recording, shots: Iterator[Shot], codec: str) -> None:
    """Write `mav0/` with cameras, inertial sensor and true states of the body.

    Also `groundtruth.tum` (the poses of cam0 at its frames), `calibration.yaml` and, if present,
    `depth/` (float32 TIFF, metres, named like the images of cam0) and `movers.csv`. Each camera has
    its own stamps, with its own jitter.

    Raises:
        OSError: a file cannot be written.
        OutputError: the same, of the truth or the calibration.
    """
    suffix = SUFFIXES[codec]
    stamps = [camera.tolist() for camera in recording.stamps_ns]
    folders = [path / "mav0" / f"cam{camera}" for camera in range(len(stamps))]
    for camera, folder in enumerate(folders):
        (folder / "data").mkdir(parents=True)
        _write_yaml(folder / "sensor.yaml", _camera_sensor(recording, camera))
        write_lines(folder / "data.csv", _image_lines(recording, camera, suffix))
    _write_body(path / "mav0", recording)
    write_tum(path / "groundtruth.tum", written_truth(recording))
    write_calibration(path / "calibration.yaml", recording.rig)
    write_movers(path / "movers.csv", recording)
    if recording.has_depth:
        (path / "depth").mkdir()
    write_images(
        shots,
        codec,
        lambda camera, index: folders[camera] / "data" / f"{stamps[camera][index]}{suffix}",
        lambda index: path / "depth" / f"{stamps[0][index]}.tiff",
    )


def _write_body(mav0: Path, recording: Recording) -> None:
    _write_yaml(mav0 / "body.yaml", {"comment": recording.name})
    states = mav0 / "state_groundtruth_estimate0"
    states.mkdir()
    write_states(states / "data.csv", recording.body_truth)
    _write_yaml(
        states / "sensor.yaml",
        {"sensor_type": "visual-inertial", "comment": "exact", "T_BS": _matrix(np.eye(4))},
    )
    if recording.imu is not None:
        (mav0 / "imu0").mkdir()
        write_imu(mav0 / "imu0" / "data.csv", recording.imu)
        _write_yaml(mav0 / "imu0" / "sensor.yaml", _imu_sensor(recording.imu))


def _image_lines(recording: Recording, camera: int, suffix: str) -> Iterator[str]:
    yield "#timestamp [ns],filename"
    for stamp in written_stamps(recording, camera):
        yield f"{stamp},{stamp}{suffix}"


def _camera_sensor(recording: Recording, number: int) -> dict[str, Any]:
    camera, body_from_cam = recording.rig.cameras[number], recording.body_from_cams[number]
    sensor: dict[str, Any] = {
        "sensor_type": "camera",
        "comment": f"cam{number}",
        "T_BS": _matrix(body_from_cam),
        "rate_hz": float(recording.fps),
        "resolution": [int(camera.width), int(camera.height)],
        "camera_model": "pinhole",
        "intrinsics": [float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "distortion_model": _DISTORTION.get(camera.distortion_model, camera.distortion_model),
        "distortion_coefficients": [float(x) for x in camera.distortion] or [0.0] * 4,
    }
    if camera.readout_s:
        sensor["readout_s"] = float(camera.readout_s)
    return sensor


def _imu_sensor(imu: Imu) -> dict[str, Any]:
    sensor: dict[str, Any] = {"sensor_type": "imu", "comment": "imu0"}
    if imu.frame == BODY:
        sensor["T_BS"] = _matrix(np.eye(4) if imu.recorded_pose is None else imu.recorded_pose)
    sensor["rate_hz"] = float(imu.rate_hz)
    if imu.noise is not None:
        sensor |= {
            "gyroscope_noise_density": float(imu.noise.gyro_noise),
            "gyroscope_random_walk": float(imu.noise.gyro_walk),
            "accelerometer_noise_density": float(imu.noise.accel_noise),
            "accelerometer_random_walk": float(imu.noise.accel_walk),
        }
    return sensor


def _matrix(a_from_b: Floats) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": [float(x) for x in a_from_b.ravel()]}


def _write_yaml(path: Path, data: dict[str, Any]) -> None:
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=400)
    path.write_text(text, encoding="utf-8", newline="\n")
