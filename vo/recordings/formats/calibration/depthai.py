"""Reader of DepthAI's calibration of OAK cameras, as its `eepromToJsonFile` writes it.

Each camera has extrinsics that take points from its own frame to that of another camera, in
centimetres. The pair is that of `stereoRectificationData`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import make_rig, make_rotation, matrix_camera
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    as_section,
    shortened,
)
from vo.recordings.formats.calibration.numbers import is_list, make_list, make_number

_LENSES = {0: "radtan", 1: "equidistant"}
"""DepthAI's CameraModel: Perspective and Fisheye."""
_LEFT, _RIGHT = 1, 2
_M_PER_CM = 1e-2

_Cameras = Mapping[int, Mapping[str, Any]]


def recognises(document: Document) -> bool:
    """Whether there is a list `cameraData`."""
    return is_list(document.data.get("cameraData"))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the stereo pair, or the camera whose size is that of the images."""
    cameras = _cameras(document)
    left, right = _pair(document)
    fitting = [number for number, each in cameras.items() if _size(each) == image_size]
    if left not in cameras or (fitting and left not in fitting):
        number = fitting[0] if fitting else next(iter(cameras))
        return Calibration(Rig(_camera(document, cameras, number)))
    cam0 = _camera(document, cameras, left)
    if right not in cameras:
        return Calibration(Rig(cam0))
    cam1_from_cam0 = _b_from_a(document, cameras, left, right)
    where = f"{document.path}: extrinsics of cameras {left} and {right}"
    return Calibration(make_rig(where, cam0, _camera(document, cameras, right), cam1_from_cam0))


def _cameras(document: Document) -> dict[int, Mapping[str, Any]]:
    """The calibrated cameras by socket."""
    cameras = {}
    for entry in document.data["cameraData"]:
        if not is_list(entry) or len(entry) != 2:
            raise CalibrationError(
                f"{document.path}: cameraData has {shortened(entry)}; it must be a list of "
                "[socket, camera]"
            )
        socket = int(make_number(f"{document.path}: cameraData: socket", entry[0]))
        camera = as_section(f"{document.path}: camera {socket}", entry[1])
        if camera.get("intrinsicMatrix"):
            cameras[socket] = camera
    if not cameras:
        raise CalibrationError(f"{document.path}: no camera has an intrinsicMatrix")
    return cameras


def _pair(document: Document) -> tuple[int, int]:
    """Sockets of the left and the right camera."""
    stereo = document.data.get("stereoRectificationData")
    if not isinstance(stereo, Mapping):
        return _LEFT, _RIGHT
    where = f"{document.path}: stereoRectificationData"
    left, right = (
        int(make_number(f"{where}: {key}", stereo.get(key, default)))
        for key, default in (("leftCameraSocket", _LEFT), ("rightCameraSocket", _RIGHT))
    )
    return (left, right) if left >= 0 and right >= 0 else (_LEFT, _RIGHT)


def _size(camera: Mapping[str, Any]) -> tuple[Any, Any]:
    return camera.get("width"), camera.get("height")


def _camera(document: Document, cameras: _Cameras, number: int) -> Camera:
    where, camera = f"{document.path}: camera {number}", cameras[number]
    kind = camera.get("cameraType", 0)
    if not isinstance(kind, int) or kind not in _LENSES:
        raise CalibrationError(
            f"{where}: cameraType {shortened(kind)[:40]} is not supported; supported are 0 "
            "(perspective) and 1 (fisheye)"
        )
    if camera.get("distortionCoeff") is None:
        raise CalibrationError(f"{where}: distortionCoeff is missing; [] if there is no distortion")
    coefficients = make_list(f"{where}: distortionCoeff", camera["distortionCoeff"])
    if _LENSES[kind] == "equidistant" and not any(coefficients[4:]):
        coefficients = coefficients[:4]  # the list has the length of the other model
    return matrix_camera(
        where,
        resolution=list(_size(camera)),
        matrix=camera["intrinsicMatrix"],
        distortion_model=_LENSES[kind],
        distortion=coefficients,
    )


def _b_from_a(document: Document, cameras: _Cameras, a: int, b: int) -> Floats:
    """The transform between two cameras along the chain of extrinsics."""
    links: dict[tuple[int, int], Floats] = {}
    for number, camera in cameras.items():
        extrinsics = camera.get("extrinsics")
        if isinstance(extrinsics, Mapping) and extrinsics.get("rotationMatrix"):
            where = f"{document.path}: camera {number}: extrinsics"
            other = int(make_number(f"{where}: toCameraSocket", extrinsics.get("toCameraSocket")))
            if other in cameras and other != number:
                links[number, other] = _transform(where, extrinsics)
                links[other, number] = inverse(links[number, other])
    found = {a: np.eye(4)}
    for _ in cameras:
        for (start, end), end_from_start in links.items():
            if start in found and end not in found:
                found[end] = end_from_start @ found[start]
    if b not in found:
        raise CalibrationError(
            f"{document.path}: no extrinsics connect cameras {a} and {b}; use `mode=mono`, or "
            "calibrate the pair"
        )
    return np.asarray(found[b])


def _transform(where: str, extrinsics: Mapping[str, Any]) -> Floats:
    rotation = make_rotation(f"{where}: rotationMatrix", extrinsics["rotationMatrix"])
    translation = as_section(f"{where}: translation", extrinsics.get("translation"))
    t_cm = [make_number(f"{where}: translation {axis}", translation.get(axis)) for axis in "xyz"]
    return make_transform(rotation, _M_PER_CM * np.array(t_cm))
