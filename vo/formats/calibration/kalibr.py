"""Reader of Kalibr's `camchain.yaml`; uses the first two cameras."""

from __future__ import annotations

from collections.abc import Mapping

from vo.errors import CalibrationError
from vo.formats.calibration.checks import check_baseline, make_camera, make_transform
from vo.formats.calibration.document import Calibration, Document, ImageSize
from vo.geometry.transforms import inverse
from vo.types import Camera, Floats, Rig


def recognises(document: Document) -> bool:
    """Whether the section cam0 has Kalibr's keys."""
    cam0 = document.data.get("cam0")
    return isinstance(cam0, Mapping) and ("camera_model" in cam0 or "distortion_coeffs" in cam0)


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read cam0 and cam1, if any.

    Raises:
        CalibrationError: a value is missing or implausible.
    """
    cam0 = _camera(document, "cam0")
    body_from_cam0 = None
    if "T_cam_imu" in document.section("cam0"):
        body_from_cam0 = inverse(_transform(document, "cam0", "T_cam_imu"))
    if "cam1" not in document.data:
        return Calibration(Rig(cam0), body_from_cam0)
    cam1 = _camera(document, "cam1")
    cam1_from_cam0 = _transform(document, "cam1", "T_cn_cnm1")
    check_baseline(f"{document.path}: cam1.T_cn_cnm1", cam1_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0), body_from_cam0)


def _camera(document: Document, name: str) -> Camera:
    section = document.section(name)
    return make_camera(
        f"{document.path}: {name}",
        model=section.get("camera_model"),
        resolution=section.get("resolution"),
        intrinsics=section.get("intrinsics"),
        distortion_model=section.get("distortion_model"),
        distortion=section.get("distortion_coeffs"),
    )


def _transform(document: Document, name: str, key: str) -> Floats:
    where = f"{document.path}: {name}.{key}"
    value = document.section(name).get(key)
    if value is None:
        raise CalibrationError(f"{where} is missing; it is the pose of the camera, a 4x4 matrix")
    return make_transform(where, value)
