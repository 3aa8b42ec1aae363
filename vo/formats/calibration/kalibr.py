"""Reader of Kalibr's `camchain.yaml`, and of OpenVINS' files of the same layout.

Uses the first two cameras. `T_cn_cnm1` is cam1_from_cam0, `T_cam_imu` is cam_from_imu, and
OpenVINS' `T_imu_cam` is imu_from_cam.
"""

from __future__ import annotations

from collections.abc import Mapping

from vo.errors import CalibrationError
from vo.formats.calibration.checks import check_baseline, make_camera, make_transform
from vo.formats.calibration.document import Calibration, Document, ImageSize
from vo.formats.calibration.keys import Entry, Values, find_distortion
from vo.geometry.transforms import inverse
from vo.types import Camera, Floats, Rig

_OWN_KEYS = (
    "camera_model", "distortion_coeffs", "T_cam_imu", "T_imu_cam", "T_cn_cnm1", "cam_overlaps",
)  # fmt: skip


def recognises(document: Document) -> bool:
    """Whether the section cam0 has Kalibr's keys."""
    cam0 = document.data.get("cam0")
    return isinstance(cam0, Mapping) and any(key in cam0 for key in _OWN_KEYS)


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read cam0 and cam1, if any.

    Raises:
        CalibrationError: a value is missing or implausible.
    """
    cam0 = _camera(document, "cam0", image_size)
    imu_from_cam0 = _imu_from_camera(document, "cam0")
    if "cam1" not in document.data:
        return Calibration(Rig(cam0), imu_from_cam0)
    cam1 = _camera(document, "cam1", image_size)
    cam1_from_cam0 = _cam1_from_cam0(document, imu_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0), imu_from_cam0)


def _camera(document: Document, name: str, image_size: ImageSize | None) -> Camera:
    section = document.section(name)
    where = f"{document.path}: {name}"
    values, model = Values(section), section.get("camera_model")
    distortion: tuple[float, ...] = ()
    if model in (None, "pinhole", "omni") and section.get("distortion_model") != "none":
        beside = Entry("intrinsics", section.get("intrinsics"))
        distortion = find_distortion(where, values, beside)
    return make_camera(
        where,
        model=model or "pinhole",
        resolution=section.get("resolution", image_size),
        intrinsics=section.get("intrinsics"),
        distortion_model=section.get("distortion_model"),
        distortion=distortion or section.get("distortion_coeffs"),
    )


def _imu_from_camera(document: Document, name: str) -> Floats | None:
    """Pose of a camera on the IMU, (4, 4); None if the file does not contain it."""
    section, where = document.section(name), f"{document.path}: {name}"
    if section.get("T_imu_cam") is not None:
        return make_transform(f"{where}.T_imu_cam", section["T_imu_cam"])
    if section.get("T_cam_imu") is not None:
        return inverse(make_transform(f"{where}.T_cam_imu", section["T_cam_imu"]))
    return None


def _cam1_from_cam0(document: Document, imu_from_cam0: Floats | None) -> Floats:
    where = f"{document.path}: cam1"
    value = document.section("cam1").get("T_cn_cnm1")
    if value is not None:
        cam1_from_cam0 = make_transform(f"{where}.T_cn_cnm1", value)
        check_baseline(f"{where}.T_cn_cnm1", cam1_from_cam0)
        return cam1_from_cam0
    imu_from_cam1 = _imu_from_camera(document, "cam1")
    if imu_from_cam0 is None or imu_from_cam1 is None:
        raise CalibrationError(
            f"{where}.T_cn_cnm1 is missing; it is the pose of the camera, a 4x4 matrix; T_cam_imu "
            "of both cameras does as well"
        )
    cam1_from_cam0 = inverse(imu_from_cam1) @ imu_from_cam0
    check_baseline(f"{where}: pose on the IMU", cam1_from_cam0)
    return cam1_from_cam0
