"""Reader and writer of vo's own calibration format, described in docs/calibration.md."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError, OutputError
from vo.base.geometry.cameras import equirectangular
from vo.base.geometry.transforms import inverse
from vo.base.noise_classes import NOISE_CLASSES
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import (
    make_camera,
    make_noise,
    make_readout,
    make_rig,
    make_time_offset,
    rectified_rig,
    rig_of,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    ImuCalibration,
    shortened,
)
from vo.recordings.formats.calibration.numbers import (
    make_number,
    make_positive,
    make_resolution,
    make_transform,
)

_TOP_KEYS = ("cam0", "cam1", "cam1_from_cam0", "baseline_m", "depth_per_metre", "imu")
_FURTHER = re.compile(r"cam([2-9]|[1-9]\d)(_from_cam0)?")
_CAMERA_KEYS = (
    "model", "resolution", "intrinsics", "distortion_model", "distortion", "readout_s",
)  # fmt: skip
_NOISE = ("gyro_noise", "gyro_walk", "accel_noise", "accel_walk")
_IMU_KEYS = ("cam0_from_imu", "time_offset_s", "class", *_NOISE)


def recognises(document: Document) -> bool:
    """Whether the file has a section cam0; other formats with one must be checked before."""
    return "cam0" in document.data


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read one camera, two, or more."""
    further = [key for key in document.data if _FURTHER.fullmatch(str(key))]
    _check_keys(str(document.path), document.data, (*_TOP_KEYS, *further))
    cam0, imu = _camera(document, "cam0"), _imu(document)
    if further:
        return Calibration(_rig_of_many(document, further), imu=imu)
    if "cam1" not in document.data and "baseline_m" not in document.data:
        return Calibration(Rig(cam0), depth_per_metre=_depth_per_metre(document), imu=imu)
    # Without cam1 both cameras of a rectified pair are the same.
    cam1 = _camera(document, "cam1") if "cam1" in document.data else cam0
    return Calibration(_rig(document, cam0, cam1), imu=imu)


def write_calibration(
    path: Path | str, rig: Rig, comments: Sequence[str] = (), imu: ImuCalibration | None = None
) -> None:
    """Write a rig; reading the file returns the same numbers exactly.

    Raises:
        OutputError: the file cannot be written.
    """
    data: dict[str, Any] = {"cam0": _section(rig.cam0)}
    if rig.cam1 is not None and rig.cam1_from_cam0 is not None:
        data["cam1"] = _section(rig.cam1)
        data["cam1_from_cam0"] = rig.cam1_from_cam0.tolist()
    for number, each in enumerate(rig.further, start=2):
        data[f"cam{number}"] = _section(each.camera)
        data[f"cam{number}_from_cam0"] = inverse(each.cam0_from_cam).tolist()
    if imu is not None:
        data["imu"] = _imu_section(imu)
    # default_flow_style=None: lists of numbers on one line, sections on several.
    text = "".join(f"# {line}\n" for line in comments)
    import yaml

    text += yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=200)
    try:
        Path(path).write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


def _section(camera: Camera) -> dict[str, Any]:
    section: dict[str, Any] = {
        "resolution": [int(camera.width), int(camera.height)],
        "intrinsics": [float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "distortion_model": camera.distortion_model,
        "distortion": [float(x) for x in camera.distortion],
    }
    if camera.readout_s:
        section["readout_s"] = float(camera.readout_s)
    return section


def _imu_section(imu: ImuCalibration) -> dict[str, Any]:
    section: dict[str, Any] = {}
    if imu.cam0_from_imu is not None:
        section["cam0_from_imu"] = imu.cam0_from_imu.tolist()
    section["time_offset_s"] = float(imu.time_offset_s)
    if imu.noise is not None:
        section |= {name: float(getattr(imu.noise, name)) for name in _NOISE}
    return section


def _imu(document: Document) -> ImuCalibration:
    if "imu" not in document.data:
        return ImuCalibration()
    where = f"{document.path}: imu"
    section = document.section("imu")
    _check_keys(where, section, _IMU_KEYS)
    pose = section.get("cam0_from_imu")
    noise = make_noise(where, section, _NOISE)
    if "class" in section:
        if noise is not None:
            raise CalibrationError(f"{where}: give either class or {', '.join(_NOISE)}")
        noise = NOISE_CLASSES.get(str(section["class"]))
        if noise is None:
            raise CalibrationError(
                f"{where}.class is {shortened(section['class'])}; it must be one of "
                f"{', '.join(NOISE_CLASSES)}"
            )
    return ImuCalibration(
        None if pose is None else make_transform(f"{where}.cam0_from_imu", pose),
        noise,
        make_time_offset(f"{where}.time_offset_s", section.get("time_offset_s")),
    )


def _camera(document: Document, name: str) -> Camera:
    where = f"{document.path}: {name}"
    section = document.section(name)
    _check_keys(where, section, _CAMERA_KEYS)
    if section.get("model") == "equirectangular":
        _check_keys(f"{where} (equirectangular)", section, ("model", "resolution"))
        return equirectangular(*make_resolution(where, section.get("resolution")))
    camera = make_camera(
        where,
        section.get("resolution"),
        section.get("intrinsics"),
        section.get("distortion_model"),
        section.get("distortion"),
        model=section.get("model", "pinhole"),
    )
    return replace(camera, readout_s=make_readout(f"{where}.readout_s", section.get("readout_s")))


def _rig(document: Document, cam0: Camera, cam1: Camera) -> Rig:
    data = document.data
    if ("cam1_from_cam0" in data) == ("baseline_m" in data):
        raise CalibrationError(
            f"{document.path}: give either cam1_from_cam0 (a 4x4 transform) or baseline_m "
            "(a rectified pair)"
        )
    if "cam1_from_cam0" in data:
        where = f"{document.path}: cam1_from_cam0"
        return make_rig(where, cam0, cam1, make_transform(where, data["cam1_from_cam0"]))
    where = f"{document.path}: baseline_m"
    baseline_m = make_number(where, data["baseline_m"])
    if baseline_m < 0:
        raise CalibrationError(
            f"{where} is {baseline_m:g}; it must be above 0, with cam1 right of cam0"
        )
    return rectified_rig(where, cam0, cam1, baseline_m)


def _rig_of_many(document: Document, further: Sequence[str]) -> Rig:
    """More than two cameras, each with its pose; their numbers leave none out."""
    last = max(int(found[1]) for key in further if (found := _FURTHER.fullmatch(key)))
    cameras, poses = [_camera(document, "cam0")], [np.eye(4)]
    for number in range(1, last + 1):
        name, key = f"cam{number}", f"cam{number}_from_cam0"
        for needed in (name, key):
            if needed not in document.data:
                raise CalibrationError(
                    f"{document.path}: {needed} is missing, but there is {further[-1]}; cameras "
                    "are cam0, cam1, cam2 and so on, each with its transform camN_from_cam0 (4x4)"
                )
        cameras.append(_camera(document, name))
        poses.append(inverse(make_transform(f"{document.path}: {key}", document.data[key])))
    return rig_of(str(document.path), cameras, poses)


def _depth_per_metre(document: Document) -> float | None:
    if "depth_per_metre" not in document.data:
        return None
    return make_positive(
        f"{document.path}: depth_per_metre",
        document.data["depth_per_metre"],
        "it must be above 0, such as 5000 for TUM",
    )


def _check_keys(where: str, data: Mapping[str, Any], known: Iterable[str]) -> None:
    known = list(known)
    for key in data:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.3)
            hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}"
            raise CalibrationError(f"{where}: unknown key '{key}'; {hint}")
