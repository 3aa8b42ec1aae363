"""Reader of Kalibr's `camchain.yaml`, and of OpenVINS' files of the same layout.

Cameras are cam0, cam1 and so on. `T_cn_cnm1` is cam1_from_cam0 and cam2_from_cam1, `T_cam_imu` is
cam_from_imu, and OpenVINS' `T_imu_cam` is imu_from_cam. The noise of the IMU is in a file beside,
Kalibr's `imu.yaml` or OpenVINS' `kalibr_imu_chain.yaml`, or in a section `imu0`. It is
continuous-time: rad/s/√Hz and m/s²/√Hz, random walks rad/s²/√Hz and m/s³/√Hz.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.types import Camera, Floats, ImuNoise, Rig
from vo.recordings.formats.calibration.checks import (
    check_baseline,
    make_camera,
    make_noise,
    make_time_offset,
    rig_of,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
    load_document,
    shortened,
)
from vo.recordings.formats.calibration.keys import Entry, Values, find_distortion
from vo.recordings.formats.calibration.numbers import make_transform

OPENVINS_IMU = "relative_config_imu"
NOISE_KEYS = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)
_OWN_KEYS = (
    "camera_model", "distortion_coeffs", "T_cam_imu", "T_imu_cam", "T_cn_cnm1", "cam_overlaps",
)  # fmt: skip
_MAX_FILES = 20
_MAX_DISAGREEMENT_RAD = 0.02
_MAX_DISAGREEMENT = 0.1  # of the baseline
_log = logging.getLogger(__name__)


def recognises(document: Document) -> bool:
    """Whether the section cam0 has Kalibr's keys."""
    cam0 = document.data.get("cam0")
    return isinstance(cam0, Mapping) and any(key in cam0 for key in _OWN_KEYS)


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read cam0 and all that follow."""
    cam0 = _camera(document, "cam0", image_size)
    imu_from_cam0 = _imu_from_camera(document, "cam0")
    imu = ImuCalibration(
        None if imu_from_cam0 is None else inverse(imu_from_cam0),
        _noise(document),
        make_time_offset(
            f"{document.path}: cam0.timeshift_cam_imu",
            document.section("cam0").get("timeshift_cam_imu"),
        ),
    )
    if "cam1" not in document.data:
        return Calibration(Rig(cam0), imu_from_cam0, imu=imu)
    cam1 = _camera(document, "cam1", image_size)
    if "cam2" not in document.data:
        cam1_from_cam0 = _pose_after(document, 1, imu_from_cam0)
        return Calibration(Rig(cam0, cam1, cam1_from_cam0), imu_from_cam0, imu=imu)
    cameras, poses, before = [cam0], [np.eye(4)], imu_from_cam0
    while (name := f"cam{len(cameras)}") in document.data:
        moved = _pose_after(document, len(cameras), before)
        poses.append(poses[-1] @ inverse(moved))
        cameras.append(_camera(document, name, image_size))
        before = _imu_from_camera(document, name)
    return Calibration(rig_of(str(document.path), cameras, poses), imu_from_cam0, imu=imu)


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
        section.get("resolution", image_size),
        section.get("intrinsics"),
        section.get("distortion_model"),
        distortion or section.get("distortion_coeffs"),
        model=model or "pinhole",
    )


def _imu_from_camera(document: Document, name: str) -> Floats | None:
    """Pose of a camera on the IMU, (4, 4); None if the file does not contain it."""
    section, where = document.section(name), f"{document.path}: {name}"
    if section.get("T_imu_cam") is not None:
        return make_transform(f"{where}.T_imu_cam", section["T_imu_cam"])
    if section.get("T_cam_imu") is not None:
        return inverse(make_transform(f"{where}.T_cam_imu", section["T_cam_imu"]))
    return None


def _pose_after(document: Document, number: int, imu_from_before: Floats | None) -> Floats:
    """Transform from the camera before to a camera: cam1_from_cam0, cam2_from_cam1, and so on."""
    name, is_pair = f"cam{number}", "cam2" not in document.data
    where = f"{document.path}: {name}"
    value = document.section(name).get("T_cn_cnm1")
    imu_from_cam = _imu_from_camera(document, name)
    if value is not None:
        moved = make_transform(f"{where}.T_cn_cnm1", value)
        if is_pair:
            check_baseline(f"{where}.T_cn_cnm1", moved)
        if imu_from_before is not None and imu_from_cam is not None:
            _check_agreement(document, number, moved, inverse(imu_from_cam) @ imu_from_before)
        return moved
    if imu_from_before is None or imu_from_cam is None:
        raise CalibrationError(
            f"{where}.T_cn_cnm1 is missing; it is the pose of the camera, a 4x4 matrix; T_cam_imu "
            f"of {'both' if is_pair else 'all'} cameras does as well"
        )
    moved = inverse(imu_from_cam) @ imu_from_before
    if is_pair:
        check_baseline(f"{where}: pose on the IMU", moved)
    return moved


def _check_agreement(document: Document, number: int, moved: Floats, by_imu: Floats) -> None:
    """Warn if the poses of two cameras on the IMU contradict that of one relative to the other."""
    off = inverse(moved) @ by_imu
    angle, shift = float(rotation_angle(off[:3, :3])), float(np.linalg.norm(off[:3, 3]))
    baseline = float(np.linalg.norm(moved[:3, 3]))
    if angle > _MAX_DISAGREEMENT_RAD or shift > _MAX_DISAGREEMENT * baseline:
        _log.warning(
            "%s: the poses of cam%d and cam%d on the IMU contradict T_cn_cnm1 by %.2g degrees and "
            "%.2g m; is T_cam_imu the pose of the camera on the IMU instead of its inverse?",
            document.path,
            number - 1,
            number,
            np.degrees(angle),
            shift,
        )


def _noise(document: Document) -> ImuNoise | None:
    """The noise in a camera chain, in the file that it names, or in the only such file beside it.

    Files beside are those with `imu` in their names. Several that differ cause a warning, and none
    of them is used.
    """
    own = _noise_in(document)
    if own is not None:
        return own
    named = document.data.get(OPENVINS_IMU)
    if named is not None:
        path = document.path.parent / str(named)
        if not path.is_file():
            _log.warning(
                "%s: %s %s does not exist; the noise of the IMU is unknown",
                document.path,
                OPENVINS_IMU,
                shortened(named),
            )
            return None
        return _noise_in(load_document(path))
    found = {path: noise for path, noise in _beside(document.path)}
    if len(set(found.values())) > 1:
        _log.warning(
            "%s have different noise of the IMU, and none of them is used; keep one",
            " and ".join(path.name for path in list(found)[:3]),
        )
        return None
    return next(iter(found.values()), None)


def _noise_in(document: Document) -> ImuNoise | None:
    imu0 = document.data.get("imu0")
    section: Mapping[str, Any] = imu0 if isinstance(imu0, Mapping) else document.data
    return make_noise(str(document.path), section, NOISE_KEYS)


def _beside(path: Path) -> Iterator[tuple[Path, ImuNoise]]:
    files = [file for file in sorted(path.parent.glob("*imu*.y*ml")) if file.name != path.name]
    for file in files[:_MAX_FILES]:
        if not file.is_file():
            continue
        try:
            document = load_document(file)
        except CalibrationError:
            continue  # not a calibration
        if "cam0" not in document.data:
            noise = _noise_in(document)
            if noise is not None:
                yield file, noise
