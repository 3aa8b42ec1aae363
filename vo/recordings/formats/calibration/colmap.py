"""Reader of COLMAP's `cameras.txt`: one line per camera, without poses of cameras.

In COLMAP the corner of the top-left pixel is at (0, 0), so half a pixel is subtracted from the
principal point here.
"""

from __future__ import annotations

import logging
import re
from typing import NamedTuple

from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import make_camera
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize
from vo.recordings.formats.calibration.numbers import make_numbers, unsupported

_LINE = re.compile(r"^[ \t]*(\d+)[ ,\t]+([A-Z_]{3,})[ ,\t]+(\d+)[ ,\t]+(\d+)\b(.*)$", re.MULTILINE)
_CORNER_TO_CENTRE_PX = 0.5
_log = logging.getLogger(__name__)


class _Model(NamedTuple):
    """Parameters of a model: one or two focal lengths, cx, cy, then distortion coefficients.

    Attributes:
        focal_lengths: number of focal lengths: fx and fy, or a single f.
        lens: distortion model.
        coefficients: number of distortion coefficients.
        zeros: number of zeros to append to them.
    """

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
    """Whether there is a line such as `1 PINHOLE 640 480 …`, of any model."""
    return not document.data and _LINE.search(document.text) is not None


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the first camera for images of this size, or else the first camera."""
    lines = _LINE.findall(document.text)
    fitting = [line for line in lines if image_size == (int(line[2][:9]), int(line[3][:9]))]
    chosen = (fitting or lines)[0]
    if len(lines) > 1:
        _log.warning(
            "%s: only camera %s of %d is used, because the file contains no poses of cameras; use "
            "another format for a stereo pair",
            document.path,
            chosen[0],
            len(lines),
        )
    return Calibration(Rig(_camera(document, chosen)))


def _camera(document: Document, line: tuple[str, str, str, str, str]) -> Camera:
    number, name, width, height, rest = line
    where = f"{document.path}: camera {number}"
    model = _MODELS.get(name)
    if model is None:
        raise unsupported(f"{where}: model {name[:40]}", _MODELS)
    count = model.focal_lengths + 2 + model.coefficients
    values = make_numbers(f"{where}: {name}", rest.replace(",", " ").split(), count)
    focal = values[: model.focal_lengths]
    cx, cy = values[model.focal_lengths : model.focal_lengths + 2]
    return make_camera(
        where,
        [width, height],
        [focal[0], focal[-1], cx - _CORNER_TO_CENTRE_PX, cy - _CORNER_TO_CENTRE_PX],
        model.lens,
        [*values[model.focal_lengths + 2 :], *[0.0] * model.zeros],
    )
