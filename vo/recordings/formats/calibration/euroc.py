"""Reader of EuRoC's `sensor.yaml`, one file per camera: cam0/sensor.yaml, cam1/sensor.yaml, ….

Kimera has files with the same keys: LeftCameraParams.yaml and RightCameraParams.yaml. `readout_s`
is a key of `vo synth`, for a rolling shutter.
"""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import count, takewhile
from pathlib import Path

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    make_camera,
    make_readout,
    make_rig,
    rig_of,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
)
from vo.recordings.formats.calibration.keys import (
    DISTORTION,
    Entry,
    Values,
    find_distortion,
    is_array,
)
from vo.recordings.formats.calibration.numbers import make_transform


def recognises(document: Document) -> bool:
    """Whether the file describes one camera mounted on a body."""
    data = document.data
    return "T_BS" in data or (
        "intrinsics" in data and Values(data).find(DISTORTION, is_array) is not None
    )


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the camera; for cam0/sensor.yaml or a left one also those of the others, if any."""
    cam0 = _camera(document, image_size)
    body_from_cam0 = _body_from_camera(document)
    partner = _partner(document.path)
    if partner is None:
        return Calibration(Rig(cam0), body_from_cam0)
    other = load_document(partner)
    others = [other, *map(load_document, _further(partner))]
    if len(others) == 1:
        cam1_from_cam0 = inverse(_body_from_camera(other)) @ body_from_cam0
        rig = make_rig(f"{partner}: T_BS", cam0, _camera(other, image_size), cam1_from_cam0)
        return Calibration(rig, body_from_cam0)
    poses = [inverse(body_from_cam0) @ _body_from_camera(each) for each in others]
    cameras = [cam0, *(_camera(each, image_size) for each in others)]
    rig = rig_of(f"{partner.parent.parent}: T_BS", cameras, [np.eye(4), *poses])
    return Calibration(rig, body_from_cam0)


def _further(partner: Path) -> list[Path]:
    """The files of cam2, cam3 and so on, beside that of cam1."""
    beside = (partner.parent.parent / f"cam{n}" / partner.name for n in count(2))
    is_numbered = partner.parent.name == "cam1"
    return list(takewhile(Path.is_file, beside)) if is_numbered else []


def _partner(path: Path) -> Path | None:
    """The file of cam1, relative to the path as given: cam0 may be a link to another folder."""
    path = Path(os.path.abspath(path))
    partner = path.parent.parent / "cam1" / path.name
    if path.parent.name == "cam0" and partner.is_file():
        return partner
    for left, right in (("Left", "Right"), ("left", "right")):
        beside = path.with_name(path.name.replace(left, right))
        if beside != path and beside.is_file():
            return beside
    return None


def _camera(document: Document, image_size: ImageSize | None) -> Camera:
    data = document.data
    distortion: tuple[float, ...] = ()
    if data.get("distortion_model") != "none":
        beside = Entry("intrinsics", data.get("intrinsics"))
        distortion = find_distortion(str(document.path), Values(data), beside)
    camera = make_camera(
        str(document.path),
        data.get("resolution", image_size),
        data.get("intrinsics"),
        data.get("distortion_model"),
        distortion,
        model=data.get("camera_model", "pinhole"),
    )
    readout_s = make_readout(f"{document.path}: readout_s", data.get("readout_s"))
    return replace(camera, readout_s=readout_s)


def _body_from_camera(document: Document) -> Floats:
    if "T_BS" not in document.data:
        raise CalibrationError(f"{document.path}: T_BS is missing; it is the pose of the camera")
    return make_transform(f"{document.path}: T_BS", document.data["T_BS"])
