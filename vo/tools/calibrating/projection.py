"""Lens models, and projection of board corners with derivatives."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.types import Camera, DistortionModel, Floats


class LensModel(NamedTuple):
    """A lens model that can be calibrated."""

    name: str
    distortion_model: DistortionModel  # the same of `Camera`
    coefficients: int

    @property
    def size(self) -> int:
        """Number of parameters: fx, fy, cx, cy and the coefficients."""
        return 4 + self.coefficients

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        if self.distortion_model == "equidistant":
            return ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return ("fx", "fy", "cx", "cy", *names[: self.coefficients])


LENS_MODELS = (
    LensModel("radtan", "radtan", 4),
    LensModel("radtan5", "radtan", 5),
    LensModel("equidistant", "equidistant", 4),
    LensModel("radtan8", "radtan", 8),
)
"""Lens models, those with fewer parameters first."""


class Projection(NamedTuple):
    """Projected points and their derivatives."""

    xy: Floats  # (N, 2) pixels
    # (2 N, lens.size) derivatives by fx, fy, cx, cy and the coefficients
    intrinsics_jacobian: Floats
    pose_jacobian: Floats  # (2 N, 6) derivatives by rotation vector and translation


def project(lens: LensModel, intrinsics: Floats, pose: Floats, points: Floats) -> Projection:
    """Project points of the board into the image.

    `intrinsics`: (lens.size,) fx, fy, cx, cy and the coefficients. `pose`: (6,) rotation vector and
    translation of cam_from_board. `points`: (N, 3) points on the board in metres.
    """
    fx, fy, cx, cy = intrinsics[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    turn, shift, k = pose[:3], pose[3:], intrinsics[4:]
    if lens.distortion_model == "equidistant":
        columns = (turn.reshape(3, 1), shift.reshape(3, 1))
        xy, jacobian = cv2.fisheye.projectPoints(points[:, None, :], *columns, matrix, k)
        # OpenCV's columns: f, c, k1 to k4, rotation, translation, skew.
        return Projection(xy.reshape(-1, 2), jacobian[:, :8], jacobian[:, 8:14])
    xy, jacobian = cv2.projectPoints(points, turn, shift, matrix, k)
    # OpenCV's columns: rotation, translation, f, c, coefficients.
    return Projection(xy.reshape(-1, 2), jacobian[:, 6 : 6 + lens.size], jacobian[:, :6])


def camera_of(lens: LensModel, intrinsics: Floats, size: tuple[int, int]) -> Camera:
    """The `Camera` with these intrinsics; `size` is width and height."""
    fx, fy, cx, cy, *coefficients = (float(value) for value in intrinsics)
    return Camera(*size, fx, fy, cx, cy, lens.distortion_model, tuple(coefficients))
