"""COLMAP's `cameras.txt`: one line a camera, without where cameras are.

Its pixels have the corner of the top-left pixel at (0, 0), so that half a pixel is taken off the
principal point here.
"""

from __future__ import annotations

import logging
import re
from typing import NamedTuple

from vo.errors import CalibrationError
from vo.formats.calibration.checks import make_camera, make_numbers
from vo.formats.calibration.document import Calibration, Document, ImageSize
from vo.types import Camera, Rig

_LINE = re.compile(r"^[ \t]*(\d+)[ ,\t]+([A-Z_]{3,})[ ,\t]+(\d+)[ ,\t]+(\d+)\b(.*)$", re.MULTILINE)
_CORNER_TO_CENTRE_PX = 0.5
_log = logging.getLogger(__name__)


class _Model(NamedTuple):
    """What the parameters of a model are: of fx fy (or f once) cx cy, then of the lens."""

    focal_lengths: int
    lens: str
    coefficients: int
    zeros: int = 0


_MODELS = {
    "SIMPLE_PINHOLE": _Model(1, "none", 0),
    "PINHOLE": _Model(2, "none", 0),
    "SIMPLE_RADIAL": _Model(1, "radtan", 1, zeros=3),
    "RADIAL": _Model(1, "radtan", 2, zeros=2),
    "OPENCV": _Model(2, "radtan", 4),
    "FULL_OPENCV": _Model(2, "radtan", 8),
    "OPENCV_FISHEYE": _Model(2, "equidistant", 4),
    "SIMPLE_RADIAL_FISHEYE": _Model(1, "equidistant", 1, zeros=3),
    "RADIAL_FISHEYE": _Model(1, "equidistant", 2, zeros=2),
}


def recognises(document: Document) -> bool:
    """Whether there is a line `1 PINHOLE 640 480 …`, of whatever model."""
    return not document.data and _LINE.search(document.text) is not None


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the first camera, or the first for images of this size where there are several.

    Raises:
        CalibrationError: its model is not known or its parameters cannot be true.
    """
    lines = _LINE.findall(document.text)
    fitting = [line for line in lines if image_size == (int(line[2][:9]), int(line[3][:9]))]
    chosen = (fitting or lines)[0]
    if len(lines) > 1:
        _log.warning(
            "%s: of %d cameras camera %s is used, and where they are is not said; give a pair in "
            "another form",
            document.path,
            len(lines),
            chosen[0],
        )
    return Calibration(Rig(_camera(document, chosen)))


def _camera(document: Document, line: tuple[str, str, str, str, str]) -> Camera:
    number, name, width, height, rest = line
    where = f"{document.path}: camera {number}"
    model = _MODELS.get(name)
    if model is None:
        raise CalibrationError(f"{where}: model {name[:40]} is not known; {', '.join(_MODELS)} are")
    count = model.focal_lengths + 2 + model.coefficients
    values = make_numbers(f"{where}: {name}", rest.replace(",", " ").split(), count)
    focal = values[: model.focal_lengths]
    cx, cy = values[model.focal_lengths : model.focal_lengths + 2]
    return make_camera(
        where,
        model="pinhole",
        resolution=[width, height],
        intrinsics=[focal[0], focal[-1], cx - _CORNER_TO_CENTRE_PX, cy - _CORNER_TO_CENTRE_PX],
        distortion_model=model.lens,
        distortion=[*values[model.focal_lengths + 2 :], *[0.0] * model.zeros],
    )
