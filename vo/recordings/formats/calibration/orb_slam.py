"""Reader of the settings of ORB-SLAM3 and earlier versions.

`Camera1` and `Camera2` are the unrectified cameras, `Stereo.T_c1_c2` is camera1_from_camera2. Older
files have one rectified camera and `Camera.bf` (baseline * fx); for unrectified images also the
rectification (`LEFT.K`, `LEFT.D`, `LEFT.R`, `LEFT.P` and the same for `RIGHT`).
"""

from __future__ import annotations

from typing import Any

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    common_from_camera,
    given_size,
    make_camera,
    make_noise,
    make_rig,
    matrix_camera,
    rectified_rig,
    relative_pose,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
)
from vo.recordings.formats.calibration.keys import coefficients_of
from vo.recordings.formats.calibration.numbers import (
    make_number,
    make_positive,
    make_transform,
    unsupported,
)

_LENSES: dict[str, tuple[str, tuple[str, ...]]] = {
    "pinhole": ("radtan", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kannalabrandt8": ("equidistant", ("k1", "k2", "k3", "k4")),
    "rectified": ("none", ()),
}
_NOISE = ("IMU.NoiseGyro", "IMU.GyroWalk", "IMU.NoiseAcc", "IMU.AccWalk")


def recognises(document: Document) -> bool:
    """Whether the file has the key Camera.fx, Camera1.fx or LEFT.K."""
    return any(name in document.data for name in ("Camera.fx", "Camera1.fx", "LEFT.K"))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read one camera, or two if the settings are for a stereo camera."""
    data = document.data
    if "LEFT.K" in data:
        rig = _unrectified_pair(document, image_size)
    else:
        name = "Camera1" if "Camera1.fx" in data else "Camera"
        cam0 = _camera(document, name, image_size)
        rig = _pair(document, cam0, name, image_size)
    key = next((name for name in ("IMU.T_b_c1", "Tbc") if name in data), None)
    body_from_cam0 = None
    if key is not None:
        body_from_cam0 = make_transform(f"{document.path}: {key}", data[key])
    cam0_from_imu = None if body_from_cam0 is None else inverse(body_from_cam0)
    imu = ImuCalibration(cam0_from_imu, make_noise(str(document.path), data, _NOISE))
    return Calibration(rig, body_from_cam0, _depth_per_metre(document), imu)


def _pair(document: Document, cam0: Camera, name: str, image_size: ImageSize | None) -> Rig:
    data = document.data
    # Settings of depth cameras contain a baseline too, but there is no second image.
    if _depth_per_metre(document) is not None:
        return Rig(cam0)
    if "Camera2.fx" in data:
        key = "Stereo.T_c1_c2" if "Stereo.T_c1_c2" in data else "Tlr"
        if key not in data:
            raise CalibrationError(
                f"{document.path}: Stereo.T_c1_c2 is missing; it is the pose of Camera2"
            )
        where = f"{document.path}: {key}"
        cam1_from_cam0 = inverse(make_transform(where, data[key]))
        return make_rig(where, cam0, _camera(document, "Camera2", image_size), cam1_from_cam0)
    for key, unit in (("Stereo.b", 1.0), ("Camera.bf", cam0.fx)):
        if key in data:
            where = f"{document.path}: {key}"
            value = make_number(where, data[key])
            if value < 0:
                raise CalibrationError(f"{where} is {value:g}; it must be above 0")
            return rectified_rig(where, cam0, cam0, value / unit)
    return Rig(cam0)


def _depth_per_metre(document: Document) -> float | None:
    for key in ("RGBD.DepthMapFactor", "DepthMapFactor"):
        if key in document.data:
            return make_positive(f"{document.path}: {key}", document.data[key])
    return None


def _camera(document: Document, name: str, image_size: ImageSize | None) -> Camera:
    data = document.data
    where = f"{document.path}: {name}"
    kind = str(data.get("Camera.type", "PinHole"))
    if kind.lower() not in _LENSES:
        known = ["PinHole", "KannalaBrandt8 and Rectified"]
        raise unsupported(f"{document.path}: Camera.type {kind[:40]!r}", known)
    lens, names = _LENSES[kind.lower()]
    given = {key: data[f"{name}.{key}"] for key in names if f"{name}.{key}" in data}
    coefficients = coefficients_of(where, given, lens) if lens != "none" else ()
    focal = [data.get(f"{name}.{key}") for key in ("fx", "fy", "cx", "cy")]
    size = _size(document, "Camera", image_size)
    return make_camera(where, size, focal, lens, coefficients, zero_is_none=True)


def _unrectified_pair(document: Document, image_size: ImageSize | None) -> Rig:
    """The unrectified pair, with cam1_from_cam0 derived from the rectification."""
    sides = [_side(document, side, image_size) for side in ("LEFT", "RIGHT")]
    cam1_from_cam0 = relative_pose(sides[0][1], sides[1][1])
    return make_rig(f"{document.path}: RIGHT.P", sides[0][0], sides[1][0], cam1_from_cam0)


def _side(document: Document, side: str, image_size: ImageSize | None) -> tuple[Camera, Floats]:
    data = document.data
    where = f"{document.path}: {side}"
    camera = matrix_camera(
        where,
        resolution=_size(document, side, image_size),
        matrix=data.get(f"{side}.K"),
        distortion_model="radtan",
        distortion=data.get(f"{side}.D"),
    )
    return camera, common_from_camera(where, data.get(f"{side}.R"), data.get(f"{side}.P"))


def _size(document: Document, name: str, image_size: ImageSize | None) -> Any:
    return given_size(document.data, (f"{name}.width", f"{name}.height"), image_size)
