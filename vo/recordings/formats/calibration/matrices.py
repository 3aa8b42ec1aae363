"""Creation of cameras and transforms from OpenCV's matrices K, D, R, T and P."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, make_transform, orthonormalised
from vo.base.types import Camera, Floats
from vo.recordings.formats.calibration.checks import (
    check_rotation,
    make_camera,
    make_list,
    make_matrix,
)

_MAX_ROUNDING = 1e-6
_MAX_SKEW_PX = 1.0
_log = logging.getLogger(__name__)


def matrix_camera(
    where: str, *, resolution: Any, matrix: Any, distortion_model: Any, distortion: Any
) -> Camera:
    """A camera from its 3x3 matrix K; the default distortion model is radtan."""
    k = make_matrix(f"{where}: camera matrix", matrix, 3, 3)
    _check_camera_matrix(where, k)
    coefficients = make_list(f"{where}: distortion", distortion)
    if not any(coefficients) and distortion_model in (None, "", "none", *_ZERO_IS_NONE):
        distortion_model, coefficients = "none", ()
    return make_camera(
        where,
        model="pinhole",
        resolution=resolution,
        intrinsics=[k[0, 0], k[1, 1], k[0, 2], k[1, 2]],
        distortion_model=distortion_model or "radtan",
        distortion=coefficients,
    )


def _check_camera_matrix(where: str, k: Floats) -> None:
    """Refuse a (3, 3) matrix that is not fx 0 cx / 0 fy cy / 0 0 1; warn of a skew of the axes."""
    if not k.any():
        raise CalibrationError(f"{where}: the camera matrix is zero: it was never calibrated")
    if np.any(k[2, :2]) and not np.any(k[:2, 2]):
        raise CalibrationError(f"{where}: the camera matrix is transposed; write it row by row")
    if np.abs(k[2] - (0.0, 0.0, 1.0)).max() > _MAX_ROUNDING or abs(k[1, 0]) > _MAX_ROUNDING:
        raise CalibrationError(
            f"{where}: the camera matrix has the rows {_row(k[1])} and {_row(k[2])}; they must be "
            "[0, fy, cy] and [0, 0, 1]"
        )
    if abs(k[0, 1]) > _MAX_SKEW_PX:
        _log.warning(
            "%s: the skew of the camera matrix, %g px, is not used: axes of pixels are taken as "
            "perpendicular",
            where,
            k[0, 1],
        )


def _row(numbers: Floats) -> str:
    return "[" + ", ".join(f"{number:g}" for number in numbers) + "]"


_ZERO_IS_NONE = ("radtan", "plumb_bob", "rational_polynomial")


def rotation_and_translation(where: str, rotation: Any, translation: Any) -> Floats:
    """The (4, 4) transform of OpenCV's R (3x3) and T (three numbers)."""
    r = make_rotation(f"{where}: rotation", rotation)
    t = make_list(f"{where}: translation", translation)
    if len(t) != 3:
        raise CalibrationError(f"{where}: translation has {len(t)} numbers; 3 are needed")
    return make_transform(r, np.array(t))


def make_rotation(where: str, value: Any) -> Floats:
    """A (3, 3) rotation, orthonormalised."""
    rotation = make_matrix(where, value, 3, 3)
    check_rotation(where, rotation)
    return orthonormalised(make_transform(rotation, np.zeros(3)))[:3, :3]


def make_projection(where: str, value: Any) -> tuple[Floats, Floats]:
    """A (3, 4) projection P = K [I | t] of a rectified camera, and t (3,).

    The rectified cameras of a rig have parallel axes, so that p_in_camera = p_in_common + t.
    """
    p = make_matrix(f"{where}: projection matrix", value, 3, 4)
    if not (p[0, 0] > 1e-3 and p[1, 1] > 1e-3):
        raise CalibrationError(
            f"{where}: the projection matrix has focal lengths {p[0, 0]:g}, {p[1, 1]:g}; they must "
            "be above 0"
        )
    z = p[2, 3]
    return p, np.array([(p[0, 3] - p[0, 2] * z) / p[0, 0], (p[1, 3] - p[1, 2] * z) / p[1, 1], z])


def common_from_camera(where: str, rotation: Any, projection: Any) -> Floats:
    """(4, 4) from an unrectified camera to the common rectified frame of its rig, from R and P."""
    _, t = make_projection(where, projection)
    r = np.eye(3) if rotation is None else make_rotation(f"{where}: rectification", rotation)
    return make_transform(r, -t)


def relative_pose(common_from_cam0: Floats, common_from_cam1: Floats) -> Floats:
    """cam1_from_cam0 of two cameras, given their poses in a common frame."""
    return np.asarray(inverse(common_from_cam1) @ common_from_cam0)
