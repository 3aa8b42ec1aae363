"""Reader of Basalt's `calibration.json`; uses the first two cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, make_transform, rotation_from_quat_xyzw
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    check_baseline,
    make_camera,
    make_list,
    make_number,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
    as_section,
    shortened,
)
from vo.recordings.formats.calibration.imu import make_noise, make_time_offset

_LENSES: dict[str, tuple[str, tuple[str, ...]]] = {
    "pinhole": ("none", ()),
    "pinhole-radtan8": ("radtan", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kb4": ("equidistant", ("k1", "k2", "k3", "k4")),
    "ds": ("double_sphere", ("xi", "alpha")),
    "eucm": ("extended_unified", ("alpha", "beta")),
    "ucm": ("extended_unified", ("alpha",)),
}
_NOISE = ("gyro_noise_std", "gyro_bias_std", "accel_noise_std", "accel_bias_std")


def recognises(document: Document) -> bool:
    """Whether the file has a section value0 with intrinsics."""
    value = document.data.get("value0")
    return isinstance(value, Mapping) and "intrinsics" in value


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the first camera and the second, if any; the body is the IMU."""
    section = document.section("value0")
    intrinsics = _items(document, section, "intrinsics")
    cam0 = _camera(document, section, intrinsics, 0, image_size)
    has_extrinsics = section.get("T_imu_cam") is not None
    body_from_cam0 = _body_from_camera(document, section, 0) if has_extrinsics else None
    imu = _imu(document, section, body_from_cam0)
    if len(intrinsics) < 2 or body_from_cam0 is None:
        return Calibration(Rig(cam0), body_from_cam0, imu=imu)
    cam1 = _camera(document, section, intrinsics, 1, image_size)
    cam1_from_cam0 = inverse(_body_from_camera(document, section, 1)) @ body_from_cam0
    check_baseline(f"{document.path}: T_imu_cam", cam1_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0), body_from_cam0, imu=imu)


def _imu(
    document: Document, section: Mapping[str, Any], body_from_cam0: Floats | None
) -> ImuCalibration:
    """Noise of each axis, of which the root mean square is used, and the time offset."""
    given: dict[str, float] = {}
    for name in _NOISE:
        if section.get(name) is not None:
            numbers = make_list(f"{document.path}: {name}", section[name])
            given[name] = min(numbers) if min(numbers, default=0.0) < 0 else _rms(numbers)
    offset_ns = section.get("cam_time_offset_ns")
    offset_s = 0.0
    if offset_ns is not None:
        where = f"{document.path}: cam_time_offset_ns"
        offset_s = make_time_offset(where, 1e-9 * make_number(where, offset_ns))
    return ImuCalibration(
        None if body_from_cam0 is None else inverse(body_from_cam0),
        make_noise(str(document.path), given, _NOISE),
        offset_s,
    )


def _rms(numbers: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(numbers)))) if numbers else 0.0


def _camera(
    document: Document,
    section: Mapping[str, Any],
    intrinsics: Sequence[Any],
    index: int,
    image_size: ImageSize | None,
) -> Camera:
    where = f"{document.path}: intrinsics {index}"
    entry = as_section(where, intrinsics[index])
    kind = entry.get("camera_type")
    if not isinstance(kind, str) or kind not in _LENSES:
        raise CalibrationError(
            f"{where}: camera_type {str(kind)[:40]!r} is not supported; supported are "
            f"{', '.join(_LENSES)}"
        )
    values = as_section(f"{where}: intrinsics", entry.get("intrinsics"))
    lens, names = _LENSES[kind]
    coefficients = [make_number(f"{where}: {name}", values.get(name)) for name in names]
    if kind == "ucm":
        coefficients.append(1.0)  # the extended model with beta 1
    resolution = section.get("resolution")
    sizes = _items(document, section, "resolution") if resolution is not None else [image_size]
    return make_camera(
        where,
        model="pinhole",
        resolution=sizes[min(index, len(sizes) - 1)],
        intrinsics=[values.get(name) for name in ("fx", "fy", "cx", "cy")],
        distortion_model=lens,
        distortion=coefficients,
    )


def _body_from_camera(document: Document, section: Mapping[str, Any], index: int) -> Floats:
    """T_imu_cam is imu_from_camera."""
    where = f"{document.path}: T_imu_cam {index}"
    poses = _items(document, section, "T_imu_cam")
    if index >= len(poses):
        raise CalibrationError(f"{where} is missing; it is the pose of the camera")
    pose = as_section(where, poses[index])
    xyz = [make_number(f"{where}: {name}", pose.get(name)) for name in ("px", "py", "pz")]
    names = ("qx", "qy", "qz", "qw")
    quat_xyzw = np.array([make_number(f"{where}: {name}", pose.get(name)) for name in names])
    if abs(float(np.linalg.norm(quat_xyzw)) - 1.0) > 1e-2:
        raise CalibrationError(
            f"{where}: the quaternion has length {np.linalg.norm(quat_xyzw):.4g}, not 1"
        )
    return make_transform(rotation_from_quat_xyzw(quat_xyzw), np.array(xyz))


def _items(document: Document, section: Mapping[str, Any], name: str) -> Sequence[Any]:
    value = section.get(name)
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or not value:
        raise CalibrationError(
            f"{document.path}: {name} is {shortened(value)}; it must be a list with an entry for "
            "each camera"
        )
    return value
