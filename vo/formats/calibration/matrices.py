"""Cameras and pairs that a file gives as OpenCV's matrices: K, D, R, T and P."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.errors import CalibrationError
from vo.formats.calibration.checks import (
    check_rotation,
    make_camera,
    make_list,
    make_matrix,
)
from vo.geometry.transforms import inverse, make_transform, orthonormalised
from vo.types import Camera, Floats


def matrix_camera(
    where: str, *, resolution: Any, matrix: Any, distortion_model: Any, distortion: Any
) -> Camera:
    """A camera from its 3x3 matrix K; coefficients without a model are radtan's.

    Raises:
        CalibrationError: a value is missing or cannot be true.
    """
    k = make_matrix(f"{where}: camera matrix", matrix, 3, 3)
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


_ZERO_IS_NONE = ("radtan", "plumb_bob", "rational_polynomial")


def rotation_and_shift(where: str, rotation: Any, translation: Any) -> Floats:
    """The (4, 4) transform of a 3x3 rotation and three numbers, as OpenCV's R and T.

    Raises:
        CalibrationError: a number is missing or the rotation is none.
    """
    turn = make_rotation(f"{where}: rotation", rotation)
    shift = make_list(f"{where}: translation", translation)
    if len(shift) != 3:
        raise CalibrationError(f"{where}: translation has {len(shift)} numbers; 3 are needed")
    return make_transform(turn, np.array(shift))


def make_rotation(where: str, value: Any) -> Floats:
    """A (3, 3) rotation, made exactly orthonormal.

    Raises:
        CalibrationError: a number is missing or it is no rotation.
    """
    rotation = make_matrix(where, value, 3, 3)
    check_rotation(where, rotation)
    return orthonormalised(make_transform(rotation, np.zeros(3)))[:3, :3]


def make_projection(where: str, value: Any) -> tuple[Floats, Floats]:
    """A (3, 4) projection P = K [1 | t] of a rectified camera, and t (3,).

    The rectified cameras of a rig have the same axes; p_in_camera = p_in_common + t.

    Raises:
        CalibrationError: a number is missing or cannot be true.
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
    """(4, 4) from a recorded camera to the frame that its rig is rectified to, by its R and P.

    Raises:
        CalibrationError: a number is missing or cannot be true.
    """
    _, t = make_projection(where, projection)
    turn = np.eye(3) if rotation is None else make_rotation(f"{where}: rectification", rotation)
    return make_transform(turn, -t)


def between(common_from_cam0: Floats, common_from_cam1: Floats) -> Floats:
    """cam1_from_cam0 of two cameras whose places in a common frame are known."""
    return np.asarray(inverse(common_from_cam1) @ common_from_cam0)
