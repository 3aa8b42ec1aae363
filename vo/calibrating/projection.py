"""Corners of a board as a camera sees them, with derivatives by all that is unknown."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.types import Camera, DistortionModel, Floats


class Lens(NamedTuple):
    """A kind of camera that can be calibrated.

    Attributes:
        name: what it is called on the command line and in reports.
        model: the `distortion_model` of `Camera`.
        coefficients: how many it has.
    """

    name: str
    model: DistortionModel
    coefficients: int

    @property
    def size(self) -> int:
        """Number of its unknowns: fx, fy, cx, cy and the coefficients."""
        return 4 + self.coefficients

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the unknowns, in order."""
        if self.model == "equidistant":
            return ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return ("fx", "fy", "cx", "cy", *names[: self.coefficients])


LENSES = (
    Lens("radtan", "radtan", 4),
    Lens("radtan5", "radtan", 5),
    Lens("equidistant", "equidistant", 4),
    Lens("radtan8", "radtan", 8),
)
"""Those with fewer unknowns first."""


class Seen(NamedTuple):
    """Where points fall, and the derivatives.

    Attributes:
        xy: (N, 2) pixels.
        by_lens: (2 N, lens.size) by fx, fy, cx, cy and the coefficients.
        by_pose: (2 N, 6) by rotation vector and translation.
    """

    xy: Floats
    by_lens: Floats
    by_pose: Floats


def see(lens: Lens, intrinsics: Floats, pose: Floats, points: Floats) -> Seen:
    """Project points.

    Args:
        lens: the kind of camera.
        intrinsics: (lens.size,) fx, fy, cx, cy and the coefficients.
        pose: (6,) rotation vector and translation of cam_from_board.
        points: (N, 3) on the board.
    """
    fx, fy, cx, cy = intrinsics[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    turn, shift, k = pose[:3], pose[3:], intrinsics[4:]
    if lens.model == "equidistant":
        columns = (turn.reshape(3, 1), shift.reshape(3, 1))
        xy, jacobian = cv2.fisheye.projectPoints(points[:, None, :], *columns, matrix, k)
        # OpenCV's columns: f, c, k1 to k4, rotation, translation, skew.
        return Seen(xy.reshape(-1, 2), jacobian[:, :8], jacobian[:, 8:14])
    xy, jacobian = cv2.projectPoints(points, turn, shift, matrix, k)
    # OpenCV's columns: rotation, translation, f, c, coefficients.
    return Seen(xy.reshape(-1, 2), jacobian[:, 6 : 6 + lens.size], jacobian[:, :6])


def camera_of(lens: Lens, intrinsics: Floats, size: tuple[int, int]) -> Camera:
    """The `Camera` of such unknowns; `size` is width and height."""
    fx, fy, cx, cy, *coefficients = (float(value) for value in intrinsics)
    return Camera(*size, fx, fy, cx, cy, lens.model, tuple(coefficients))
