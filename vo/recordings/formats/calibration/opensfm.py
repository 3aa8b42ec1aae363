"""Reader of OpenSfM's and OpenDroneMap's cameras.json and camera_models.json: one camera.

Lengths are relative to the larger side of the image, and the principal point to its centre.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import equirectangular
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import make_camera
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize, shortened
from vo.recordings.formats.calibration.numbers import make_number, make_resolution, unsupported

_RADTAN = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE = ("k1", "k2", "k3", "k4")
_PROJECTIONS = {
    "perspective": ("radtan", _RADTAN),
    "simple_radial": ("radtan", _RADTAN),
    "radial": ("radtan", _RADTAN),
    "brown": ("radtan", _RADTAN),
    "fisheye": ("equidistant", _FISHEYE),
    "fisheye_opencv": ("equidistant", _FISHEYE),
}
_SPHERICAL = ("spherical", "equirectangular")
_SIZE = ("width", "height")
_MAX_RELATIVE = 50.0
_CENTRE_PX = 0.5
"""(0, 0) is the centre of a pixel, half a pixel from the corner."""


def recognises(document: Document) -> bool:
    """Whether a camera has a relative focal length."""
    return bool(_cameras(document))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the only camera, or the only one for images of this size."""
    cameras = _cameras(document)
    fitting = {name: c for name, c in cameras.items() if image_size in (None, _size(name, c))}
    if len(cameras) > 1 and len(fitting) != 1:
        raise CalibrationError(
            f"{document.path}: has {len(cameras)} cameras, {', '.join(cameras)[:200]}; give a file "
            "with that of these images only"
        )
    (name, values) = next(iter((fitting or cameras).items()))
    return Calibration(Rig(_camera(f"{document.path}: {name}", values)))


def _cameras(document: Document) -> dict[str, Mapping[str, Any]]:
    """Cameras by name, of the file or of its section `cameras`."""
    sections = document.data.get("cameras", document.data)
    if not isinstance(sections, Mapping):
        return {}
    named = {"camera": sections, **sections}
    return {str(name): s for name, s in named.items() if isinstance(s, Mapping) and _is_camera(s)}


def _is_camera(values: Mapping[str, Any]) -> bool:
    if values.get("projection_type") in _SPHERICAL:
        return True
    has_focal = "focal" in values or {"focal_x", "c_x"} <= set(values)
    return has_focal and ("projection_type" in values or {"k1", "k2"} <= set(values))


def _size(where: str, values: Mapping[str, Any]) -> ImageSize:
    return make_resolution(where, [values.get(key) for key in _SIZE])


def _camera(where: str, values: Mapping[str, Any]) -> Camera:
    projection = str(values.get("projection_type", "perspective"))
    if projection in _SPHERICAL:
        return equirectangular(*_size(where, values))
    if projection not in _PROJECTIONS:
        raise unsupported(f"{where}: projection_type {shortened(projection)[:40]}", _PROJECTIONS)
    size = _size(where, values)
    model, names = _PROJECTIONS[projection]

    def relative(key: str, other: Any = 0.0) -> float:
        return make_number(f"{where}: {key}", values.get(key, other))

    focal_x = relative("focal_x", values.get("focal"))
    focal_y = relative("focal_y", focal_x * relative("aspect_ratio", 1.0))
    if max(focal_x, focal_y) > _MAX_RELATIVE:
        raise CalibrationError(
            f"{where}: focal length is {focal_x:g}; it is relative to the larger side of the image"
        )
    scale = max(size)
    centre = [
        scale * relative(key) + side / 2 - _CENTRE_PX
        for key, side in zip(("c_x", "c_y"), size, strict=True)
    ]
    intrinsics = [scale * focal_x, scale * focal_y, *centre]
    coefficients = [relative(name) for name in names]
    return make_camera(where, size, intrinsics, model, coefficients, zero_is_none=True)
