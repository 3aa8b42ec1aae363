"""Reader of ROS's camera_info as YAML or INI, one file per camera, in the same folder.

The images are assumed to be unrectified (`image_raw`), as described by K and D.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration import keys, ros_ini
from vo.recordings.formats.calibration.checks import check_baseline, make_list
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
)
from vo.recordings.formats.calibration.matrices import (
    common_from_camera,
    matrix_camera,
    relative_pose,
)

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
_MIN_BASELINE_M = 1e-6
_log = logging.getLogger(__name__)


def recognises(document: Document) -> bool:
    """Whether the file has the fields of the message, as saved or as printed by `topic echo`."""
    if ros_ini.is_ini(document.text):
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
    check_baseline(f"{partner}: projection matrix", cam1_from_cam0)
    return Calibration(Rig(cam0, _camera(other, image_size), cam1_from_cam0))


def partner_of(path: Path) -> Path | None:
    """The file of the right camera beside that of the left one, found by its name."""
    for left, right in _NAMES:
        if left in path.name:
            partner = path.with_name(path.name.replace(left, right))
            return partner if partner.is_file() else None
    return None


def _camera(document: Document, image_size: ImageSize | None) -> Camera:
    fields = _fields(document)
    size = [fields.get("width"), fields.get("height")]
    where = str(document.path)
    return matrix_camera(
        where,
        resolution=image_size if None in size else size,
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
    if ros_ini.is_ini(document.text) and len(numbers) == 4 and any(numbers):
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
    if ros_ini.is_ini(document.text):
        return ros_ini.fields_of(document.text)
    data = document.data
    found = {name: data.get(name, data.get(name.upper())) for name in ("d", "k", "r", "p")}
    found |= {name: data.get(name) for name in ("width", "height", "distortion_model")}
    found |= {name: data[long] for name, long in _FILE.items() if long in data}
    return {name: value for name, value in found.items() if value is not None}
