"""Readers of lists of cameras with their poses on a body: SVO and maplab, OKVIS, and Basalt.

SVO and maplab (aslam_cv2) have `cameras: - camera:` with `T_B_C`,
which is body_from_camera, or its inverse `T_C_B`; OKVIS has `cameras:` with `T_SC`, which is
sensor_from_camera, the sensor being the IMU; Basalt's `calibration.json` has `T_imu_cam`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, rotation_from_quat_xyzw
from vo.base.geometry.transforms import make_transform as rigid
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    given_size,
    make_camera,
    make_noise,
    make_rig,
    make_time_offset,
    rig_of,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
    as_section,
    shortened,
)
from vo.recordings.formats.calibration.numbers import (
    is_list,
    make_list,
    make_number,
    make_numbers,
    make_transform,
    unsupported,
)

_Section = Mapping[str, Any]

_MAPLAB_TYPES = {"pinhole": "pinhole", "omni": "omni", "unified-projection": "omni"}
_KALIBR_OMNI = 5  # xi and fx, fy, cx, cy
_MAPLAB_LENSES = ("none", "radial-tangential", "radtan", "equidistant")
_OKVIS_IMU = ("imu_parameters", "imu_params")
_OKVIS_NOISE = ("sigma_g_c", "sigma_gw_c", "sigma_a_c", "sigma_aw_c")
_BASALT_LENSES: dict[str, tuple[str, tuple[str, ...]]] = {
    "pinhole": ("none", ()),
    "pinhole-radtan8": ("radtan", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kb4": ("equidistant", ("k1", "k2", "k3", "k4")),
    "ds": ("double_sphere", ("xi", "alpha")),
    "eucm": ("extended_unified", ("alpha", "beta")),
    "ucm": ("extended_unified", ("alpha",)),
}
_BASALT_NOISE = ("gyro_noise_std", "gyro_bias_std", "accel_noise_std", "accel_bias_std")


def _rig(where: str, cameras: Sequence[Camera], body_from_cameras: Sequence[Floats]) -> Rig:
    if len(cameras) == 2:
        cam1_from_cam0 = inverse(body_from_cameras[1]) @ body_from_cameras[0]
        return make_rig(where, cameras[0], cameras[1], cam1_from_cam0)
    return rig_of(where, cameras, [inverse(body_from_cameras[0]) @ e for e in body_from_cameras])


def _has_cameras_with(document: Document, key: str) -> bool:
    cameras = document.data.get("cameras")
    return is_list(cameras) and any(isinstance(each, Mapping) and key in each for each in cameras)


def recognises_maplab(document: Document) -> bool:
    """Whether there is a list of cameras, each with a section `camera`, or one such camera."""
    if "type" in document.data and isinstance(document.data.get("distortion"), Mapping):
        return "intrinsics" in document.data
    return _has_cameras_with(document, "camera")


def read_maplab(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read a rig of SVO or maplab, or a single camera without its pose."""
    if "cameras" not in document.data:
        camera = _maplab_camera(document, {"camera": document.data}, 0, image_size)
        return Calibration(Rig(camera))
    entries = [
        as_section(f"{document.path}: cameras, entry {i}", each)
        for i, each in enumerate(document.data["cameras"])
    ]
    cameras, poses = [], []
    for index, entry in enumerate(entries):
        cameras.append(_maplab_camera(document, entry, index, image_size))
        poses.append(_maplab_pose(f"{document.path}: camera {index}", entry))
    known = [pose for pose in poses if pose is not None]
    if len(known) < len(poses) and len(poses) > 1:
        raise CalibrationError(
            f"{document.path}: T_B_C is missing; it is the pose of a camera on the body, a 4x4 "
            "matrix"
        )
    return Calibration(_rig(f"{document.path}: T_B_C", cameras, known), poses[0])


def _maplab_camera(
    document: Document, entry: _Section, index: int, image_size: ImageSize | None
) -> Camera:
    where = f"{document.path}: camera {index}"
    camera = as_section(where, entry.get("camera"))
    kind = str(camera.get("type")).strip().lower()
    intrinsics = make_list(f"{where}: intrinsics", camera.get("intrinsics"))
    if kind == "omni" and len(intrinsics) > _KALIBR_OMNI:
        kind = "omni (Scaramuzza's model)"
    if kind not in _MAPLAB_TYPES:
        raise unsupported(f"{where}: type {shortened(kind)[:40]}", _MAPLAB_TYPES)
    lens = as_section(f"{where}: distortion", camera.get("distortion"))
    name = str(lens.get("type")).strip().lower()
    if name not in _MAPLAB_LENSES:  # `fisheye` is the FOV model with one parameter here
        shown = shortened(lens.get("type"))[:40]
        raise unsupported(f"{where}: distortion type {shown}", _MAPLAB_LENSES)
    return make_camera(
        where,
        given_size(camera, ("image_width", "image_height"), image_size),
        intrinsics,
        name,
        make_list(f"{where}: distortion parameters", lens.get("parameters")),
        model=_MAPLAB_TYPES[kind],
        zero_is_none=lens.get("parameters") is not None,
    )


def _maplab_pose(where: str, entry: _Section) -> Floats | None:
    if entry.get("T_B_C") is not None:
        return make_transform(f"{where}: T_B_C", entry["T_B_C"])
    if entry.get("T_C_B") is not None:
        return inverse(make_transform(f"{where}: T_C_B", entry["T_C_B"]))
    return None


def recognises_okvis(document: Document) -> bool:
    """Whether there is a list of cameras with `T_SC`."""
    return _has_cameras_with(document, "T_SC")


def read_okvis(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the settings of OKVIS; the body is the IMU."""
    cameras, poses = [], []
    for index, each in enumerate(document.data["cameras"]):
        where = f"{document.path}: camera {index}"
        entry = as_section(where, each)
        cameras.append(_okvis_camera(where, entry, image_size))
        if entry.get("T_SC") is None:
            raise CalibrationError(
                f"{where}: T_SC is missing; it is the pose of the camera on the IMU"
            )
        poses.append(make_transform(f"{where}: T_SC", entry["T_SC"]))
    rig = _rig(f"{document.path}: T_SC", cameras, poses)
    return Calibration(rig, poses[0], imu=_okvis_imu(document, inverse(poses[0])))


def _okvis_imu(document: Document, cam0_from_imu: Floats) -> ImuCalibration:
    """The section of the IMU; `image_delay` is that of the images relative to the IMU."""
    name = next((name for name in _OKVIS_IMU if name in document.data), None)
    noise = None
    if name is not None:
        noise = make_noise(f"{document.path}: {name}", document.section(name), _OKVIS_NOISE)
    cameras = document.data.get("camera_parameters")
    section = cameras if isinstance(cameras, Mapping) else document.data
    key = "image_delay" if "image_delay" in section else "imageDelay"
    delay_s = make_time_offset(f"{document.path}: {key}", section.get(key))
    return ImuCalibration(cam0_from_imu, noise, -delay_s)


def _okvis_camera(where: str, entry: _Section, image_size: ImageSize | None) -> Camera:
    if entry.get("distortion_coefficients") is None:
        raise CalibrationError(
            f"{where}: distortion_coefficients is missing; [0, 0, 0, 0] for none"
        )
    coefficients = make_list(f"{where}: distortion", entry["distortion_coefficients"])
    return make_camera(
        where,
        entry.get("image_dimension", image_size),
        [
            *make_numbers(f"{where}: focal_length", entry.get("focal_length"), 2),
            *make_numbers(f"{where}: principal_point", entry.get("principal_point"), 2),
        ],
        entry.get("distortion_type", "missing"),
        coefficients,
        zero_is_none=True,
    )


def recognises_basalt(document: Document) -> bool:
    """Whether the file has a section value0 with intrinsics."""
    value = document.data.get("value0")
    return isinstance(value, Mapping) and "intrinsics" in value


def read_basalt(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read Basalt's calibration; the body is the IMU."""
    section = document.section("value0")
    intrinsics = _items(document, section, "intrinsics")
    has_poses = section.get("T_imu_cam") is not None
    cameras, poses = [], []
    for index in range(len(intrinsics) if has_poses else 1):
        cameras.append(_basalt_camera(document, section, intrinsics, index, image_size))
        if has_poses:
            poses.append(_basalt_pose(document, section, index))
    body_from_cam0 = poses[0] if poses else None
    imu = _basalt_imu(document, section, body_from_cam0)
    return Calibration(_rig(f"{document.path}: T_imu_cam", cameras, poses), body_from_cam0, imu=imu)


def _basalt_imu(
    document: Document, section: _Section, body_from_cam0: Floats | None
) -> ImuCalibration:
    """Noise of each axis, of which the root mean square is used, and the time offset."""
    given: dict[str, float] = {}
    for name in _BASALT_NOISE:
        if section.get(name) is not None:
            numbers = make_list(f"{document.path}: {name}", section[name])
            mean = float(np.sqrt(np.mean(np.square(numbers)))) if numbers else 0.0
            given[name] = min(numbers) if min(numbers, default=0.0) < 0 else mean
    offset_ns = section.get("cam_time_offset_ns")
    offset_s = 0.0
    if offset_ns is not None:
        where = f"{document.path}: cam_time_offset_ns"
        offset_s = make_time_offset(where, 1e-9 * make_number(where, offset_ns))
    return ImuCalibration(
        None if body_from_cam0 is None else inverse(body_from_cam0),
        make_noise(str(document.path), given, _BASALT_NOISE),
        offset_s,
    )


def _basalt_camera(
    document: Document,
    section: _Section,
    intrinsics: Sequence[Any],
    index: int,
    image_size: ImageSize | None,
) -> Camera:
    where = f"{document.path}: intrinsics {index}"
    entry = as_section(where, intrinsics[index])
    kind = entry.get("camera_type")
    if not isinstance(kind, str) or kind not in _BASALT_LENSES:
        raise unsupported(f"{where}: camera_type {str(kind)[:40]!r}", _BASALT_LENSES)
    values = as_section(f"{where}: intrinsics", entry.get("intrinsics"))
    lens, names = _BASALT_LENSES[kind]
    coefficients = [make_number(f"{where}: {name}", values.get(name)) for name in names]
    if kind == "ucm":
        coefficients.append(1.0)  # the extended model with beta 1
    has_sizes = section.get("resolution") is not None
    sizes = _items(document, section, "resolution") if has_sizes else [image_size]
    focal = [values.get(name) for name in ("fx", "fy", "cx", "cy")]
    return make_camera(where, sizes[min(index, len(sizes) - 1)], focal, lens, coefficients)


def _basalt_pose(document: Document, section: _Section, index: int) -> Floats:
    """T_imu_cam is imu_from_camera."""
    where = f"{document.path}: T_imu_cam {index}"
    poses = _items(document, section, "T_imu_cam")
    if index >= len(poses):
        raise CalibrationError(f"{where} is missing; it is the pose of the camera")
    pose = as_section(where, poses[index])
    xyz, quat_xyzw = (
        np.array([make_number(f"{where}: {name}", pose.get(name)) for name in names])
        for names in (("px", "py", "pz"), ("qx", "qy", "qz", "qw"))
    )
    if abs(float(np.linalg.norm(quat_xyzw)) - 1.0) > 1e-2:
        raise CalibrationError(
            f"{where}: the quaternion has length {np.linalg.norm(quat_xyzw):.4g}, not 1"
        )
    return rigid(rotation_from_quat_xyzw(quat_xyzw), xyz)


def _items(document: Document, section: _Section, name: str) -> Sequence[Any]:
    value = section.get(name)
    if not is_list(value) or not value:
        raise CalibrationError(
            f"{document.path}: {name} is {shortened(value)}; it must be a list with an entry for "
            "each camera"
        )
    return value
