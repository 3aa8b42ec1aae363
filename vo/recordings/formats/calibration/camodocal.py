"""Reader of camodocal's camera files, and of the settings of VINS-Mono and VINS-Fusion.

A camera file has `model_type`, `projection_parameters` and `distortion_parameters`. VINS-Mono has
the same keys in its settings, with imu_from_cam as `extrinsicRotation` and `extrinsicTranslation`;
VINS-Fusion has `cam0_calib`, `cam1_calib`, files beside the settings, and imu_from_cam as
`body_T_cam0` and `body_T_cam1`. Both have `rolling_shutter_tr`, the readout time.

Source: Heng et al., CamOdoCal, 2013; MEI is Mei and Rives, 2007.
"""

from __future__ import annotations

import os
from dataclasses import astuple, replace
from typing import NamedTuple

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Floats, ImuNoise, Rig
from vo.recordings.formats.calibration.checks import (
    given_size,
    make_camera,
    make_noise,
    make_readout,
    make_rig,
    make_time_offset,
    rotation_and_translation,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
    load_document,
)
from vo.recordings.formats.calibration.numbers import make_number, make_transform

_NOISE = ("gyr_n", "gyr_w", "acc_n", "acc_w")
_VINS_RATE_HZ = 200.0


class _Model(NamedTuple):
    """A camera model: its lens, and the section and names of the lens' coefficients, in order.

    `focal` are the names of fx, fy, cx, cy among `projection_parameters`.
    """

    lens: str
    section: str
    coefficients: tuple[str, ...]
    focal: tuple[str, ...] = ("fx", "fy", "cx", "cy")


_DISTORTION, _PROJECTION = "distortion_parameters", "projection_parameters"
_MODELS = {
    "PINHOLE": _Model("radtan", _DISTORTION, ("k1", "k2", "p1", "p2")),
    "PINHOLE_FULL": _Model("radtan", _DISTORTION, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    # Its k2 belongs to the third power of the angle, which is k1 elsewhere.
    "KANNALA_BRANDT": _Model(
        "equidistant", _PROJECTION, ("k2", "k3", "k4", "k5"), ("mu", "mv", "u0", "v0")
    ),
    "MEI": _Model("omni", _DISTORTION, ("k1", "k2", "p1", "p2"), ("gamma1", "gamma2", "u0", "v0")),
}


def recognises(document: Document) -> bool:
    """Whether the file is a camera of camodocal, or settings of VINS."""
    data = document.data
    return "cam0_calib" in data or (
        "model_type" in data and any(str(key).endswith("_parameters") for key in data)
    )


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read a camera, or the first two cameras of VINS-Fusion."""
    data = document.data
    if "cam0_calib" not in data:
        pose = _vins_mono_pose(document)
        cam0 = replace(_camera(document, image_size), readout_s=_readout_s(document))
        return Calibration(Rig(cam0), pose, imu=_imu(document, pose))
    cam0 = _camera(_file_of(document, "cam0_calib"), image_size)
    cam0 = replace(cam0, readout_s=_readout_s(document))
    body_from_cam0 = _pose(document, "body_T_cam0") if "body_T_cam0" in data else None
    if "cam1_calib" not in data or str(data.get("num_of_cam", 2)).strip() == "1":
        return Calibration(Rig(cam0), body_from_cam0, imu=_imu(document, body_from_cam0))
    cam1 = _camera(_file_of(document, "cam1_calib"), image_size)
    if body_from_cam0 is None:
        raise CalibrationError(f"{document.path}: body_T_cam0 is missing; it is a 4x4 matrix")
    cam1_from_cam0 = inverse(_pose(document, "body_T_cam1")) @ body_from_cam0
    rig = make_rig(f"{document.path}: body_T_cam1", cam0, cam1, cam1_from_cam0)
    return Calibration(rig, body_from_cam0, imu=_imu(document, body_from_cam0))


def _readout_s(document: Document) -> float:
    """Readout time of a rolling shutter in the settings of VINS; 0 unless it is turned on."""
    data = document.data
    is_rolling = str(data.get("rolling_shutter", 0)).strip() == "1"
    where = f"{document.path}: rolling_shutter_tr"
    return make_readout(where, data.get("rolling_shutter_tr") if is_rolling else None)


def _imu(document: Document, imu_from_cam0: Floats | None) -> ImuCalibration:
    """Noise and time offset in the settings of VINS: image clock + td is the clock of the IMU.

    VINS's noise is that of a sample, and its rate is in no file: that of EuRoC is assumed.
    """
    data, where = document.data, str(document.path)
    noise = make_noise(where, data, _NOISE)
    if noise is not None:
        noise = ImuNoise(*(value / np.sqrt(_VINS_RATE_HZ) for value in astuple(noise)))
    return ImuCalibration(
        None if imu_from_cam0 is None else inverse(imu_from_cam0),
        noise,
        make_time_offset(f"{where}: td", data.get("td")),
    )


def _file_of(document: Document, key: str) -> Document:
    """The camera file that the settings name, relative to their own folder."""
    name = document.data[key]
    if not isinstance(name, str) or not name.strip():
        raise CalibrationError(f"{document.path}: {key} must be the name of a file")
    path = document.path.parent / name.strip()
    if not path.is_file():
        raise CalibrationError(f"{document.path}: {key}: {os.path.normpath(path)} does not exist")
    return load_document(path)


def _camera(document: Document, image_size: ImageSize | None) -> Camera:
    data, where = document.data, str(document.path)
    name = str(data.get("model_type")).strip().upper()
    model = _MODELS.get(name)
    if model is None:
        raise CalibrationError(
            f"{where}: model_type {name[:40]} is not supported; calibrate with one of "
            f"{', '.join(_MODELS)}"
        )
    projection = document.section(_PROJECTION)
    missing = 0.0 if name == "PINHOLE_FULL" else None
    given = [(model.section, key) for key in model.coefficients]
    given = [("mirror_parameters", "xi"), *given] if model.lens == "omni" else given
    return make_camera(
        where,
        given_size(data, ("image_width", "image_height"), image_size),
        [projection.get(key) for key in model.focal],
        model.lens,
        [_number(document, section, key, missing) for section, key in given],
        zero_is_none=True,
    )


def _number(document: Document, section: str, key: str, default: float | None) -> float:
    values = document.section(section)
    if key not in values and default is None:
        raise CalibrationError(f"{document.path}: {section}: {key} is missing")
    return make_number(f"{document.path}: {section}: {key}", values.get(key, default))


def _pose(document: Document, key: str) -> Floats:
    if document.data.get(key) is None:
        raise CalibrationError(f"{document.path}: {key} is missing; it is a 4x4 matrix")
    return make_transform(f"{document.path}: {key}", document.data[key])


def _vins_mono_pose(document: Document) -> Floats | None:
    """Pose of the camera on the IMU; None if VINS-Mono is to estimate it without a first guess."""
    data = document.data
    if "extrinsicRotation" not in data or str(data.get("estimate_extrinsic", 0)).strip() == "2":
        return None
    return rotation_and_translation(
        f"{document.path}: extrinsicRotation, extrinsicTranslation",
        data["extrinsicRotation"],
        data.get("extrinsicTranslation"),
    )
