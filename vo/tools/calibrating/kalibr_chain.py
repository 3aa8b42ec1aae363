"""Writer of Kalibr's camera chain with an inertial sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from vo.base.files.complete_file import writing
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration import ImuCalibration

_COEFFICIENTS = 4


def write_chain(path: Path, rig: Rig, imu: ImuCalibration) -> str:
    """Write `camchain-imucam.yaml`; returns why not, if Kalibr has no such lens, else nothing.

    Raises:
        OutputError: the file cannot be written.
    """
    assert imu.cam0_from_imu is not None
    cameras = [(rig.cam0, imu.cam0_from_imu)]
    if rig.cam1 is not None and rig.cam1_from_cam0 is not None:
        cameras.append((rig.cam1, rig.cam1_from_cam0 @ imu.cam0_from_imu))
    chain: dict[str, Any] = {}
    for number, (camera, cam_from_imu) in enumerate(cameras):
        lens = _lens(camera)
        if lens is None:
            return f"Kalibr has no {camera.distortion_model} with its coefficients"
        chain[f"cam{number}"] = _section(camera, lens, cam_from_imu, imu.time_offset_s)
    if rig.cam1_from_cam0 is not None:
        chain["cam1"]["T_cn_cnm1"] = rig.cam1_from_cam0.tolist()
    text = yaml.safe_dump(chain, sort_keys=False, default_flow_style=None, width=200)
    with writing(path):
        path.write_text(text, encoding="utf-8", newline="\n")
    return ""


def _lens(camera: Camera) -> tuple[str, list[float]] | None:
    """Kalibr's name of the lens and its four coefficients; None if there is no such lens."""
    first = [float(x) for x in camera.distortion[:_COEFFICIENTS]]
    if camera.distortion_model == "none":
        return "radtan", [0.0] * _COEFFICIENTS
    if camera.distortion_model == "radtan" and not any(camera.distortion[_COEFFICIENTS:]):
        return "radtan", first
    if camera.distortion_model == "equidistant":
        return "equidistant", first
    return None


def _section(
    camera: Camera, lens: tuple[str, list[float]], cam_from_imu: Floats, offset_s: float
) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "intrinsics": [float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "distortion_model": lens[0],
        "distortion_coeffs": lens[1],
        "resolution": [int(camera.width), int(camera.height)],
        "T_cam_imu": cam_from_imu.tolist(),
        "timeshift_cam_imu": float(offset_s),
    }
