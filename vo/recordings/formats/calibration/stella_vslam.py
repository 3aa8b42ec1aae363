"""Reader of the settings of stella_vslam and OpenVSLAM: a section `Camera`, or keys `Camera.fx`.

A stereo camera is a rectified one with `focal_x_baseline`. With a `StereoRectifier` the images are
those before rectification, with K, D and R of both cameras, and `Camera` is the rectified camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import equirectangular
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import (
    given_size,
    make_camera,
    make_rig,
    make_rotation,
    matrix_camera,
    rectified_rig,
    relative_pose,
)
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize, shortened
from vo.recordings.formats.calibration.keys import coefficients_of
from vo.recordings.formats.calibration.numbers import (
    make_number,
    make_positive,
    make_resolution,
    unsupported,
)

_LENSES = {"perspective": "radtan", "fisheye": "equidistant"}
_SETUPS = ("monocular", "stereo", "rgbd")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4")


def recognises(document: Document) -> bool:
    """Whether the file has a camera with `setup` and `model`, or with `model` and columns."""
    camera = _section(document, "Camera")
    return "model" in camera and any(key in camera for key in ("setup", "cols", "color_order"))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read one camera, or two if the settings are for a stereo camera."""
    camera = _section(document, "Camera")
    setup = str(camera.get("setup", "monocular")).strip().lower()
    if setup not in _SETUPS:
        raise unsupported(f"{document.path}: Camera.setup {setup[:40]}", _SETUPS)
    rectifier = _section(document, "StereoRectifier")
    if setup == "stereo" and rectifier:
        return Calibration(_unrectified_pair(document, camera, rectifier, image_size))
    cam0 = _camera(document, camera, image_size)
    if setup == "stereo":
        if cam0.is_distorted:
            raise CalibrationError(
                f"{document.path}: Camera is stereo and distorted, but StereoRectifier, which says "
                "where the right camera is, is missing"
            )
        where = f"{document.path}: Camera.focal_x_baseline"
        return Calibration(rectified_rig(where, cam0, cam0, _baseline_m(document, camera)))
    return Calibration(Rig(cam0), depth_per_metre=_depth_per_metre(document, camera, setup))


def _section(document: Document, name: str) -> dict[str, Any]:
    """Values of a section, or of keys that begin with its name and a dot."""
    section = document.data.get(name)
    if isinstance(section, Mapping):
        return {str(key): value for key, value in section.items()}
    start = f"{name}."
    return {k[len(start) :]: v for k, v in document.data.items() if str(k).startswith(start)}


def _camera(document: Document, camera: Mapping[str, Any], image_size: ImageSize | None) -> Camera:
    where = f"{document.path}: Camera"
    is_stereo = str(camera.get("setup", "")).strip().lower() == "stereo"
    if str(camera.get("model")).strip().lower() == "equirectangular" and not is_stereo:
        return equirectangular(*make_resolution(where, _size(camera, image_size)))
    lens = _lens(where, camera.get("model"))
    given = {key: camera[key] for key in _COEFFICIENTS if key in camera}
    if "k1" not in given:
        raise CalibrationError(f"{where}: k1 is missing; write 0 if there is no distortion")
    coefficients = coefficients_of(where, given, lens)
    focal = [camera.get(key) for key in ("fx", "fy", "cx", "cy")]
    size = _size(camera, image_size)
    return make_camera(where, size, focal, lens, coefficients, zero_is_none=True)


def _lens(where: str, model: Any) -> str:
    name = str(model).strip().lower()
    if name not in _LENSES:
        raise unsupported(f"{where}: model {shortened(model)[:40]}", _LENSES)
    return _LENSES[name]


def _size(camera: Mapping[str, Any], image_size: ImageSize | None) -> Any:
    return given_size(camera, ("cols", "rows"), image_size)


def _baseline_m(document: Document, camera: Mapping[str, Any]) -> float:
    where = f"{document.path}: Camera.focal_x_baseline"
    if camera.get("focal_x_baseline") is None:
        raise CalibrationError(f"{where} is missing; it is the focal length times the baseline")
    value = make_number(where, camera["focal_x_baseline"])
    if value < 0:
        raise CalibrationError(f"{where} is {value:g}; it must be above 0")
    return value / make_number(f"{document.path}: Camera.fx", camera.get("fx"))


def _unrectified_pair(
    document: Document,
    camera: Mapping[str, Any],
    rectifier: Mapping[str, Any],
    image_size: ImageSize | None,
) -> Rig:
    cameras, poses = [], []
    for side, shift_m in (("left", 0.0), ("right", _baseline_m(document, camera))):
        where = f"{document.path}: StereoRectifier"
        if f"D_{side}" not in rectifier:
            raise CalibrationError(f"{where}: D_{side} is missing; [] if there is no distortion")
        cameras.append(
            matrix_camera(
                f"{where}: K_{side}",
                resolution=_size(camera, image_size),
                matrix=rectifier.get(f"K_{side}"),
                distortion_model=_lens(where, rectifier.get("model", "perspective")),
                distortion=rectifier[f"D_{side}"],
            )
        )
        rotation = make_rotation(f"{where}: R_{side}", rectifier.get(f"R_{side}"))
        poses.append(make_transform(rotation, np.array([shift_m, 0.0, 0.0])))
    cam1_from_cam0 = relative_pose(poses[0], poses[1])
    where = f"{document.path}: Camera.focal_x_baseline"
    return make_rig(where, cameras[0], cameras[1], cam1_from_cam0)


def _depth_per_metre(document: Document, camera: Mapping[str, Any], setup: str) -> float | None:
    sections = (camera, _section(document, "Preprocessing"), document.data)
    value = next((s["depthmap_factor"] for s in sections if "depthmap_factor" in s), None)
    if setup != "rgbd" or value is None:
        return None
    return make_positive(f"{document.path}: depthmap_factor", value, "not above 0")
