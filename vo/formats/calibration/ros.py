"""ROS's camera_info as YAML, a file per camera; that of the right camera is looked for beside it.

The images are taken to be the raw ones (`image_raw`), which K and D are of.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vo.formats.calibration.checks import check_baseline
from vo.formats.calibration.document import Calibration, Document, ImageSize, load_document
from vo.formats.calibration.matrices import between, common_from_camera, matrix_camera
from vo.types import Camera, Floats, Rig

_NAMES = (("left", "right"), ("Left", "Right"), ("cam0", "cam1"), ("camera0", "camera1"))
_FILE = {
    "width": "image_width",
    "height": "image_height",
    "d": "distortion_coefficients",
    "k": "camera_matrix",
    "r": "rectification_matrix",
    "p": "projection_matrix",
}
"""What camera_calibration_parsers calls the fields of the message."""
_SHORTEST_BASELINE_M = 1e-6
_log = logging.getLogger(__name__)


def recognises(document: Document) -> bool:
    """Whether it has the message's fields, as a file has them or as `topic echo` prints them."""
    data = _fields(document.data)
    is_file = "camera_matrix" in document.data and any(
        name in document.data for name in ("projection_matrix", "rectification_matrix")
    )
    return is_file or ("k" in data and "d" in data and "p" in data)


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the camera and, where its file stands beside a left one, the right camera.

    Raises:
        CalibrationError: what a file says cannot be true.
    """
    cam0 = _camera(document, image_size)
    partner = partner_of(document.path)
    if partner is None:
        return Calibration(Rig(cam0))
    other = load_document(partner)
    cam1_from_cam0 = between(_common_from_camera(document), _common_from_camera(other))
    if np.linalg.norm(cam1_from_cam0[:3, 3]) < _SHORTEST_BASELINE_M:
        _log.warning(
            "%s: the projection matrix has no baseline (Tx is 0), so it was not calibrated as a "
            "pair; only the left camera is used",
            partner,
        )
        return Calibration(Rig(cam0))
    check_baseline(f"{partner}: projection matrix", cam1_from_cam0)
    return Calibration(Rig(cam0, _camera(other, image_size), cam1_from_cam0))


def partner_of(path: Path) -> Path | None:
    """The file of the right camera beside that of the left one, told by its name."""
    for left, right in _NAMES:
        if left in path.name:
            partner = path.with_name(path.name.replace(left, right))
            return partner if partner.is_file() else None
    return None


def _camera(document: Document, image_size: ImageSize | None) -> Camera:
    fields = _fields(document.data)
    size = [fields.get("width"), fields.get("height")]
    return matrix_camera(
        str(document.path),
        resolution=image_size if None in size else size,
        matrix=fields.get("k"),
        distortion_model=fields.get("distortion_model") or "plumb_bob",
        distortion=fields.get("d"),
    )


def _common_from_camera(document: Document) -> Floats:
    fields = _fields(document.data)
    return common_from_camera(str(document.path), fields.get("r"), fields.get("p"))


def _fields(data: Mapping[str, Any]) -> dict[str, Any]:
    """The message's fields by their small names; ROS 1 prints D, K, R and P."""
    found = {name: data.get(name, data.get(name.upper())) for name in ("d", "k", "r", "p")}
    found |= {name: data.get(name) for name in ("width", "height", "distortion_model")}
    found |= {name: data[long] for name, long in _FILE.items() if long in data}
    return {name: value for name, value in found.items() if value is not None}
