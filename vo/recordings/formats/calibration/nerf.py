"""Reader of NeRF's `transforms.json`, as instant-ngp, nerfstudio and Blender write it: one camera.

Its pixels have (0, 0) at the corner of the top-left pixel, so half a pixel is subtracted from the
principal point. `vo.recordings.formats.nerf_poses` reads the poses of the images.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from vo.base.errors import CalibrationError
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import make_camera, make_number
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize, shortened
from vo.recordings.formats.calibration.keys import coefficients_of

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


def recognises(document: Document) -> bool:
    """Whether there are frames with a `transform_matrix`, or a focal length by NeRF's name."""
    data = document.data
    frames = data.get("frames")
    return (
        isinstance(frames, Sequence)
        and not isinstance(frames, str)
        and ("fl_x" in data or "camera_angle_x" in data or _have_poses(frames))
    )


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
        raise CalibrationError(
            f"{where}: camera_model {shortened(values['camera_model'])[:40]} is not supported; "
            f"supported are {', '.join(_MODELS)}"
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
    is_ideal = not is_fisheye and not any(coefficients)
    width, height = _size(where, values, image_size)
    fx, fy = _focal_lengths(where, values, width, height)
    return make_camera(
        where,
        model="pinhole",
        resolution=[width, height],
        intrinsics=[
            fx,
            fy,
            make_number(f"{where}: cx", values.get("cx", width / 2)) - _CORNER_TO_CENTRE_PX,
            make_number(f"{where}: cy", values.get("cy", height / 2)) - _CORNER_TO_CENTRE_PX,
        ],
        distortion_model="none" if is_ideal else lens,
        distortion=() if is_ideal else coefficients,
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


def _size(
    where: str, values: Mapping[str, Any], image_size: ImageSize | None
) -> tuple[float, float]:
    if "w" in values and "h" in values:
        return make_number(f"{where}: w", values["w"]), make_number(f"{where}: h", values["h"])
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
