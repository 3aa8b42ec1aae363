"""Reader of a camera matrix alone, as text: 3x3 of Stray Scanner, 4x4 of ScanNet.

The camera models of the Oxford RobotCar data set look alike, but are refused, with what to do.
"""

from __future__ import annotations

import logging

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.types import Floats, Rig
from vo.recordings.formats.calibration.checks import make_camera
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize

_log = logging.getLogger(__name__)
_MAX_LINES = 8


def recognises(document: Document) -> bool:
    """Whether the text is a camera matrix, or a camera model of RobotCar."""
    matrix = _matrix(document)
    return matrix is not None and (_is_robotcar(matrix) or _is_intrinsic(matrix))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the camera, which has no distortion."""
    matrix = _matrix(document)
    assert matrix is not None
    if _is_robotcar(matrix):
        raise CalibrationError(
            f"{document.path} is a camera model of RobotCar, which is that of undistorted images: "
            "write those with the data set's SDK (undistortion table and demosaicing), and give a "
            f"file with `cam0: {{resolution: [WIDTH, HEIGHT], intrinsics: {matrix[0].tolist()}}}`"
        )
    if image_size is None:
        raise CalibrationError(f"{document.path} has no image size; give it with its images")
    _log.warning("%s is a matrix alone: images without distortion are assumed", document.path)
    intrinsics = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return Calibration(Rig(make_camera(str(document.path), list(image_size), intrinsics)))


def _is_robotcar(matrix: Floats) -> bool:
    """Focal lengths and principal point, and a pose."""
    return matrix.shape == (5, 4) and bool((matrix[4] == (0, 0, 0, 1)).all())


def _is_intrinsic(matrix: Floats) -> bool:
    if matrix.shape not in ((3, 3), (4, 4)):
        return False
    rest = matrix - np.eye(len(matrix))
    rest[[0, 1, 0, 1, 0], [0, 1, 2, 2, 1]] = 0.0
    return not rest.any() and min(matrix[0, 0], matrix[1, 1]) > 1.0


def _matrix(document: Document) -> Floats | None:
    lines = [line.strip("[] ,;") for line in document.text.splitlines() if line.strip("[] ,;")]
    try:
        rows = [
            [float(field) for field in line.replace(",", " ").split()]
            for line in lines[:_MAX_LINES]
        ]
    except ValueError:
        return None
    same_width = len({len(row) for row in rows}) == 1
    return np.array(rows) if same_width and len(lines) < _MAX_LINES else None
