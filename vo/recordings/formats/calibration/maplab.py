"""Reader of the camera rigs of SVO, maplab and other programs with aslam_cv2: `cameras: - camera:`.

`T_B_C` is body_from_camera, `T_C_B` its inverse. Uses the first two cameras.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    check_baseline,
    make_camera,
    make_list,
    make_transform,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    as_section,
    shortened,
)

_TYPES = {"pinhole": "pinhole", "omni": "omni", "unified-projection": "omni"}
_KALIBR_OMNI = 5  # xi and fx, fy, cx, cy
_LENSES = ("none", "radial-tangential", "radtan", "equidistant")


def recognises(document: Document) -> bool:
    """Whether there is a list of cameras, each with a section `camera`, or one such camera."""
    cameras = document.data.get("cameras")
    if "type" in document.data and isinstance(document.data.get("distortion"), Mapping):
        return "intrinsics" in document.data
    return (
        isinstance(cameras, Sequence)
        and not isinstance(cameras, str | bytes)
        and any(isinstance(each, Mapping) and "camera" in each for each in cameras)
    )


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the first camera and the second, if any."""
    if "cameras" not in document.data:
        return Calibration(Rig(_camera(document, {"camera": document.data}, 0, image_size)))
    entries = [
        as_section(f"{document.path}: cameras, entry {i}", each)
        for i, each in enumerate(document.data["cameras"][:2])
    ]
    cam0 = _camera(document, entries[0], 0, image_size)
    body_from_cam0 = _body_from_camera(document, entries[0], 0)
    if len(entries) == 1:
        return Calibration(Rig(cam0), body_from_cam0)
    cam1 = _camera(document, entries[1], 1, image_size)
    body_from_cam1 = _body_from_camera(document, entries[1], 1)
    if body_from_cam0 is None or body_from_cam1 is None:
        raise CalibrationError(
            f"{document.path}: T_B_C is missing; it is the pose of a camera on the body, a 4x4 "
            "matrix"
        )
    cam1_from_cam0 = inverse(body_from_cam1) @ body_from_cam0
    check_baseline(f"{document.path}: T_B_C", cam1_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0), body_from_cam0)


def _camera(
    document: Document, entry: Mapping[str, Any], index: int, image_size: ImageSize | None
) -> Camera:
    where = f"{document.path}: camera {index}"
    camera = as_section(where, entry.get("camera"))
    kind = str(camera.get("type")).strip().lower()
    intrinsics = make_list(f"{where}: intrinsics", camera.get("intrinsics"))
    if kind == "omni" and len(intrinsics) > _KALIBR_OMNI:
        kind = "omni (Scaramuzza's model)"
    if kind not in _TYPES:
        raise CalibrationError(
            f"{where}: type {shortened(kind)[:40]} is not supported; supported are "
            f"{', '.join(_TYPES)}"
        )
    lens = as_section(f"{where}: distortion", camera.get("distortion"))
    name = str(lens.get("type")).strip().lower()
    if name not in _LENSES:  # `fisheye` is the FOV model with one parameter here
        raise CalibrationError(
            f"{where}: distortion type {shortened(lens.get('type'))[:40]} is not supported; "
            f"supported are {', '.join(_LENSES)}"
        )
    coefficients = make_list(f"{where}: distortion parameters", lens.get("parameters"))
    size = [camera.get("image_width"), camera.get("image_height")]
    is_ideal = (
        name != "equidistant" and lens.get("parameters") is not None and not any(coefficients)
    )
    return make_camera(
        where,
        model=_TYPES[kind],
        resolution=image_size if None in size else size,
        intrinsics=intrinsics,
        distortion_model="none" if is_ideal else name,
        distortion=() if is_ideal else coefficients,
    )


def _body_from_camera(document: Document, entry: Mapping[str, Any], index: int) -> Floats | None:
    where = f"{document.path}: camera {index}"
    if entry.get("T_B_C") is not None:
        return make_transform(f"{where}: T_B_C", entry["T_B_C"])
    if entry.get("T_C_B") is not None:
        return inverse(make_transform(f"{where}: T_C_B", entry["T_C_B"]))
    return None
