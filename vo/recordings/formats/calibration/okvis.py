"""Reader of the settings of OKVIS: `cameras:` with `T_SC`, which is sensor_from_camera.

The sensor is the IMU. Uses the first two cameras.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    check_baseline,
    make_camera,
    make_list,
    make_numbers,
    make_transform,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
    as_section,
)
from vo.recordings.formats.calibration.imu import make_noise, make_time_offset

_IMU_SECTIONS = ("imu_parameters", "imu_params")
_NOISE = ("sigma_g_c", "sigma_gw_c", "sigma_a_c", "sigma_aw_c")


def recognises(document: Document) -> bool:
    """Whether there is a list of cameras with `T_SC`."""
    cameras = document.data.get("cameras")
    return (
        isinstance(cameras, Sequence)
        and not isinstance(cameras, str | bytes)
        and any(isinstance(each, Mapping) and "T_SC" in each for each in cameras)
    )


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the first camera and the second, if any."""
    entries = [
        as_section(f"{document.path}: camera {i}", each)
        for i, each in enumerate(document.data["cameras"][:2])
    ]
    cameras, poses = [], []
    for index, entry in enumerate(entries):
        where = f"{document.path}: camera {index}"
        cameras.append(_camera(where, entry, image_size))
        poses.append(_body_from_camera(where, entry))
    imu = _imu(document, inverse(poses[0]))
    if len(entries) == 1:
        return Calibration(Rig(cameras[0]), poses[0], imu=imu)
    cam1_from_cam0 = inverse(poses[1]) @ poses[0]
    check_baseline(f"{document.path}: T_SC", cam1_from_cam0)
    return Calibration(Rig(cameras[0], cameras[1], cam1_from_cam0), poses[0], imu=imu)


def _imu(document: Document, cam0_from_imu: Floats) -> ImuCalibration:
    """The section of the IMU; `image_delay` is that of the images relative to the IMU."""
    name = next((name for name in _IMU_SECTIONS if name in document.data), None)
    noise = None
    if name is not None:
        where = f"{document.path}: {name}"
        noise = make_noise(where, as_section(where, document.data[name]), _NOISE)
    cameras = document.data.get("camera_parameters")
    section = cameras if isinstance(cameras, Mapping) else document.data
    key = "image_delay" if "image_delay" in section else "imageDelay"
    delay_s = make_time_offset(f"{document.path}: {key}", section.get(key))
    return ImuCalibration(cam0_from_imu, noise, -delay_s)


def _camera(where: str, entry: Mapping[str, Any], image_size: ImageSize | None) -> Camera:
    if entry.get("distortion_coefficients") is None:
        raise CalibrationError(
            f"{where}: distortion_coefficients is missing; [0, 0, 0, 0] for none"
        )
    coefficients = make_list(f"{where}: distortion", entry["distortion_coefficients"])
    model = entry.get("distortion_type", "missing")
    is_ideal = str(model).startswith("radialtangential") and not any(coefficients)
    return make_camera(
        where,
        model="pinhole",
        resolution=entry.get("image_dimension", image_size),
        intrinsics=[
            *make_numbers(f"{where}: focal_length", entry.get("focal_length"), 2),
            *make_numbers(f"{where}: principal_point", entry.get("principal_point"), 2),
        ],
        distortion_model="none" if is_ideal else model,
        distortion=() if is_ideal else coefficients,
    )


def _body_from_camera(where: str, entry: Mapping[str, Any]) -> Floats:
    if entry.get("T_SC") is None:
        raise CalibrationError(f"{where}: T_SC is missing; it is the pose of the camera on the IMU")
    return make_transform(f"{where}: T_SC", entry["T_SC"])
