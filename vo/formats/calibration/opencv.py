"""Reader of OpenCV's FileStorage (YAML, XML or JSON), with the keys of OpenCV's samples.

A pair has M1 D1 M2 D2 (or the names below), R and T with x2 = R x1 + T (cam1_from_cam0). R and T
may be in a separate file, `extrinsics` beside `intrinsics`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from vo.errors import CalibrationError
from vo.formats.calibration.checks import check_baseline
from vo.formats.calibration.document import Calibration, Document, ImageSize, load_document
from vo.formats.calibration.matrices import matrix_camera, rotation_and_translation
from vo.types import Camera, Rig

_PAIRS = (
    ("M1", "D1", "M2", "D2"),
    ("K1", "D1", "K2", "D2"),
    ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2"),
    ("camera_matrix_left", "distortion_coefficients_left",
     "camera_matrix_right", "distortion_coefficients_right"),
)  # fmt: skip
_SINGLES = (
    ("camera_matrix", "distortion_coefficients"),
    ("cameraMatrix", "distCoeffs"),
    ("camera_matrix", "dist_coeffs"),
    ("K", "D"),
)
_SIZES = (("image_width", "image_height"), ("width", "height"))
_SIZE_LISTS = ("image_size", "imageSize", "ImageSize", "resolution")
_log = logging.getLogger(__name__)


def recognises(document: Document) -> bool:
    """Whether the file has a camera matrix with one of the usual keys."""
    return any(names[0] in document.data for names in (*_PAIRS, *_SINGLES))


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read one camera or a pair.

    Raises:
        CalibrationError: a value is missing or implausible.
    """
    data = document.data
    pair = next((names for names in _PAIRS if names[0] in data), None)
    if pair is None:
        single = next(
            (names for names in _SINGLES if names[0] in data and names[1] in data),
            next(names for names in _SINGLES if names[0] in data),
        )
        return Calibration(Rig(_camera(document, *single, image_size)))
    cam0 = _camera(document, pair[0], pair[1], image_size)
    if pair[2] not in data:
        return Calibration(Rig(cam0))
    extrinsics = _extrinsics(document)
    if extrinsics is None:
        _log.warning(
            "%s: only the first camera is used, because R and T are missing; add them, or put "
            "extrinsics%s beside intrinsics%s",
            document.path,
            document.path.suffix,
            document.path.suffix,
        )
        return Calibration(Rig(cam0))
    cam1 = _camera(document, pair[2], pair[3], image_size)
    where = str(extrinsics.path)
    cam1_from_cam0 = rotation_and_translation(where, extrinsics.data["R"], extrinsics.data["T"])
    check_baseline(f"{where}: T", cam1_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0))


def _extrinsics(document: Document) -> Document | None:
    path = document.path
    beside = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    documents = [document]
    if beside != path and beside.is_file():
        documents.append(load_document(beside))
    return next((one for one in documents if "R" in one.data and "T" in one.data), None)


def _camera(
    document: Document, matrix: str, distortion: str, image_size: ImageSize | None
) -> Camera:
    where = f"{document.path}: {matrix}"
    is_fisheye = str(document.data.get("fisheye_model", 0)).strip().lower() not in ("0", "false")
    resolution = _size(document.data) or image_size
    if resolution is None:
        raise CalibrationError(f"{where}: the size of the images is missing; add image_width and "
                               "image_height")  # fmt: skip
    return matrix_camera(
        where,
        resolution=resolution,
        matrix=document.data[matrix],
        distortion_model="equidistant" if is_fisheye else "radtan",
        distortion=document.data.get(distortion),
    )


def _size(data: Mapping[str, Any]) -> Any:
    for width, height in _SIZES:
        if width in data and height in data:
            return [data[width], data[height]]
    return next((data[name] for name in _SIZE_LISTS if name in data), None)
