"""Reader of ROS's camera_info as YAML or INI, one file per camera, in the same folder.

The images are assumed to be unrectified (`image_raw`), as described by K and D. In INI, written by
`camera_calibration` (ost.txt) and by drivers, names stand on lines of their own, followed by lines
of numbers:

    [image]
    width
    640

    [narrow_stereo/left]
    camera matrix
    500.1 0.0 320.5
    0.0 500.9 239.0
    0.0 0.0 1.0
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration import keys
from vo.recordings.formats.calibration.checks import (
    common_from_camera,
    given_size,
    make_rig,
    matrix_camera,
    relative_pose,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
)
from vo.recordings.formats.calibration.numbers import make_list

_NAMES = (("left", "right"), ("Left", "Right"), ("cam0", "cam1"), ("camera0", "camera1"))
_FILE = {
    "width": "image_width",
    "height": "image_height",
    "d": "distortion_coefficients",
    "k": "camera_matrix",
    "r": "rectification_matrix",
    "p": "projection_matrix",
}
"""Keys of camera_calibration_parsers for the fields of the message."""
_INI = {
    "width": "width",
    "height": "height",
    "camera matrix": "k",
    "distortion": "d",
    "rectification": "r",
    "projection": "p",
}
_INI_MATRIX = re.compile(r"^[ \t]*camera matrix[ \t]*$", re.MULTILINE)
_MIN_BASELINE_M = 1e-6
_log = logging.getLogger(__name__)


def recognises(document: Document) -> bool:
    """Whether the file has the fields of the message, as saved or as printed by `topic echo`."""
    if _is_ini(document):
        return True
    data = _fields(document)
    is_file = "camera_matrix" in document.data and any(
        name in document.data for name in ("projection_matrix", "rectification_matrix")
    )
    return is_file or ("k" in data and "d" in data and "p" in data)


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the camera; for a left one also the right camera, if its file is beside it."""
    cam0 = _camera(document, image_size)
    partner = partner_of(document.path)
    if partner is None:
        return Calibration(Rig(cam0))
    other = load_document(partner)
    cam1_from_cam0 = relative_pose(_common_from_camera(document), _common_from_camera(other))
    if np.linalg.norm(cam1_from_cam0[:3, 3]) < _MIN_BASELINE_M:
        _log.warning(
            "%s: only the left camera is used, because the projection matrix has no baseline (Tx "
            "is 0): the cameras were not calibrated as a pair",
            partner,
        )
        return Calibration(Rig(cam0))
    where = f"{partner}: projection matrix"
    return Calibration(make_rig(where, cam0, _camera(other, image_size), cam1_from_cam0))


def partner_of(path: Path) -> Path | None:
    """The file of the right camera beside that of the left one, found by its name."""
    for left, right in _NAMES:
        if left in path.name:
            partner = path.with_name(path.name.replace(left, right))
            return partner if partner.is_file() else None
    return None


def _camera(document: Document, image_size: ImageSize | None) -> Camera:
    fields = _fields(document)
    where = str(document.path)
    return matrix_camera(
        where,
        resolution=given_size(fields, ("width", "height"), image_size),
        matrix=fields.get("k"),
        distortion_model=fields.get("distortion_model") or "plumb_bob",
        distortion=_distortion(where, document, fields),
    )


def _distortion(where: str, document: Document, fields: Mapping[str, Any]) -> tuple[float, ...]:
    if "d" in fields:
        numbers = make_list(f"{where}: distortion", fields["d"])
    else:
        values = keys.Values(document.data or fields)
        matrix = keys.find_matrix(values, "") or keys.Entry("camera matrix", fields.get("k"))
        numbers = keys.find_distortion(where, values, matrix)
    if _is_ini(document) and len(numbers) == 4 and any(numbers):
        raise CalibrationError(
            f"{where}: 4 coefficients may be those of plumb_bob or of a fisheye lens, and INI does "
            "not say which; use the YAML file of the same calibration (ost.yaml)"
        )
    return numbers


def _common_from_camera(document: Document) -> Floats:
    fields = _fields(document)
    return common_from_camera(str(document.path), fields.get("r"), fields.get("p"))


def _fields(document: Document) -> dict[str, Any]:
    """The fields of the message in lower case; ROS 1 prints D, K, R and P."""
    if _is_ini(document):
        return _ini_fields(document.text)
    data = document.data
    found = {name: data.get(name, data.get(name.upper())) for name in ("d", "k", "r", "p")}
    found |= {name: data.get(name) for name in ("width", "height", "distortion_model")}
    found |= {name: data[long] for name, long in _FILE.items() if long in data}
    return {name: value for name, value in found.items() if value is not None}


def _is_ini(document: Document) -> bool:
    return _INI_MATRIX.search(document.text) is not None


def _ini_fields(text: str) -> dict[str, object]:
    """Fields of the message camera_info, unchecked: width, height, and lists d, k, r and p."""
    words: dict[str, list[str]] = {}
    current: list[str] | None = None
    for line in text.splitlines():
        name = " ".join(line.split()).lower()
        if not name or name.startswith(("#", ";")):
            continue
        if name.startswith("["):
            current = None
        elif name in _INI:
            current = words.setdefault(_INI[name], [])
        elif name[0].isalpha() and name.split()[0] not in ("nan", "inf"):
            current = None  # a field that is not needed, such as `translation`
        elif current is not None:
            current += line.split()
    return {
        name: listed[0] if name in ("width", "height") and len(listed) == 1 else listed
        for name, listed in words.items()
    }
