"""Reader of NeRF's `transforms.json`, as instant-ngp, nerfstudio and Blender write it: one camera.

Its pixels have (0, 0) at the corner of the top-left pixel, so half a pixel is subtracted from the
principal point. `read_nerf_poses` reads the poses of the images.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import make_camera
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
    shortened,
)
from vo.recordings.formats.calibration.keys import coefficients_of
from vo.recordings.formats.calibration.numbers import (
    is_list,
    make_number,
    make_transform,
    unsupported,
)

_MODELS = {
    "SIMPLE_PINHOLE": "none",
    "PINHOLE": "none",
    "SIMPLE_RADIAL": "radtan",
    "RADIAL": "radtan",
    "OPENCV": "radtan",
    "FULL_OPENCV": "radtan",
    "OPENCV_FISHEYE": "equidistant",
}
_RADTAN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "camera_angle_x", "camera_angle_y", *_RADTAN)
_CORNER_TO_CENTRE_PX = 0.5
_OPENGL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
"""From a camera with y down and z forward to one with y up and z back."""


def recognises(document: Document) -> bool:
    """Whether there are frames with a `transform_matrix`, or a focal length by NeRF's name."""
    data = document.data
    frames = data.get("frames")
    return is_list(frames) and ("fl_x" in data or "camera_angle_x" in data or _have_poses(frames))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the camera of all frames."""
    return Calibration(Rig(_camera(document, image_size)))


def _have_poses(frames: Sequence[Any]) -> bool:
    return any(isinstance(frame, Mapping) and "transform_matrix" in frame for frame in frames)


def _camera(document: Document, image_size: ImageSize | None) -> Camera:
    where = str(document.path)
    values = _values(document)
    model = str(values.get("camera_model", "OPENCV")).strip().upper()
    if model not in _MODELS:
        raise unsupported(
            f"{where}: camera_model {shortened(values['camera_model'])[:40]}", _MODELS
        )
    is_fisheye = _MODELS[model] == "equidistant" or values.get("is_fisheye") is True
    lens = "equidistant" if is_fisheye else "radtan"
    given = {key: values.get(key, 0.0) for key in _RADTAN}
    # nerfstudio's k4 belongs to the eighth power of the radius, not to a denominator.
    if not is_fisheye and model != "FULL_OPENCV" and make_number(f"{where}: k4", given["k4"]):
        raise CalibrationError(
            f"{where}: k4 is {given['k4']}; it must be 0, unless camera_model is OPENCV_FISHEYE "
            "or FULL_OPENCV"
        )
    coefficients = coefficients_of(where, given, lens)
    width, height = _size(where, values, image_size)
    fx, fy = _focal_lengths(where, values, width, height)
    centre = [
        make_number(f"{where}: {key}", values.get(key, side / 2)) - _CORNER_TO_CENTRE_PX
        for key, side in (("cx", width), ("cy", height))
    ]
    return make_camera(
        where, [width, height], [fx, fy, *centre], lens, coefficients, zero_is_none=True
    )


def _values(document: Document) -> dict[str, Any]:
    """Values of the file, completed by those that all frames have in common."""
    frames = [frame for frame in document.data["frames"] if isinstance(frame, Mapping)]
    values = {str(key): value for key, value in document.data.items() if key != "frames"}
    for key in (*_INTRINSICS, "camera_model"):
        found = [frame[key] for frame in frames if key in frame]
        if not found:
            continue
        if any(value != found[0] for value in found) or len(found) < len(frames):
            raise CalibrationError(
                f"{document.path}: the frames have different cameras ({key}); only one camera for "
                "all of them is supported"
            )
        values[key] = found[0]
    return values


def _size(where: str, values: Mapping[str, Any], image_size: ImageSize | None) -> tuple[float, ...]:
    if "w" in values and "h" in values:
        return tuple(make_number(f"{where}: {key}", values[key]) for key in ("w", "h"))
    if image_size is None:
        raise CalibrationError(f"{where}: the size of the images is missing; add w and h")
    return image_size


def _focal_lengths(
    where: str, values: Mapping[str, Any], width: float, height: float
) -> tuple[float, float]:
    """Focal lengths in pixels, from fl_x or the field of view; fy is fx if not given."""
    fx = _focal_length(where, values, "x", width)
    if fx is None:
        raise CalibrationError(f"{where}: fl_x is missing; it is the focal length in pixels")
    fy = _focal_length(where, values, "y", height)
    return fx, fx if fy is None else fy


def _focal_length(where: str, values: Mapping[str, Any], axis: str, side: float) -> float | None:
    if f"fl_{axis}" in values:
        return make_number(f"{where}: fl_{axis}", values[f"fl_{axis}"])
    if f"camera_angle_{axis}" not in values:
        return None
    angle = make_number(f"{where}: camera_angle_{axis}", values[f"camera_angle_{axis}"])
    if not 0.0 < angle < math.pi:
        raise CalibrationError(
            f"{where}: camera_angle_{axis} is {angle:g}; it is a field of view in radians, between "
            "0 and pi"
        )
    return 0.5 * side / math.tan(0.5 * angle)


class PosedImage(NamedTuple):
    """An image and its pose.

    Attributes:
        name: path of the image, relative to the file, perhaps without suffix.
        world_from_cam: (4, 4), the camera with y down and z forward. The unit of length is any.
    """

    name: str
    world_from_cam: Floats


def read_nerf_poses(path: Path | str) -> list[PosedImage]:
    """Read all poses, in natural order of the names of the images."""
    path = Path(path)
    try:
        document = load_document(path)
    except CalibrationError as error:
        raise SourceError(str(error)) from error
    if document.problem:
        raise SourceError(f"{path} {document.problem}")
    frames = document.data.get("frames")
    if not isinstance(frames, list) or not frames:
        raise SourceError(f"{path} has no list `frames` with poses, as transforms.json of NeRF has")
    images = []
    for number, frame in enumerate(frames):
        where = f"{path}: frame {number}"
        if not isinstance(frame, Mapping) or not isinstance(frame.get("file_path"), str):
            raise SourceError(f"{where}: file_path is missing; it is the name of the image")
        try:
            pose = make_transform(f"{where}: transform_matrix", frame.get("transform_matrix"))
        except CalibrationError as error:
            raise SourceError(str(error)) from error
        name = frame["file_path"].replace("\\", "/")
        images.append(PosedImage(name, pose @ _OPENGL_FROM_CV))
    return sorted(images, key=lambda image: _natural_key(image.name))


def _natural_key(name: str) -> list[tuple[int, str]]:
    """A sort key that compares numbers in names by value."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:18]), "") if i % 2 else (0, part) for i, part in enumerate(parts)]
