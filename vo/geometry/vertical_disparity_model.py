"""By how much rows of a rectified pair differ, and what that says of the right camera.

In a rectified pair a point has the same row in both images. Where a camera was bumped, or its lens
was focused after it had been calibrated, rows differ in a way that depends on the place in the
image, and so do disparities, which cannot be seen: turned about its axis by w the right image
has rows that are off by w x and disparities that are off by w y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.geometry.quantiles import median
from vo.types import Bools, Floats

_ROUNDS = 20
_NOISE_PX = 0.1  # rows are not known better than that, however well they fit
# Neighbouring points err together: from frame to frame what is fitted to KITTI's cameras differs
# by five times what independent points would leave.
_TOGETHER = 25.0
# Standard deviations of the terms before anything was seen. A narrow lens hardly tells zoom from
# bend, and seldom has any.
_USUAL_PX = np.array([5.0, 5.0, 5.0, 1.0, 5.0])


class VerticalDisparity(NamedTuple):
    """The right image against what its calibration says; x, y are pixels over focal length.

    Attributes:
        pitch_px: it looks up or down by this; rows differ by pitch (1 + y^2).
        roll_px: it is turned about its axis; rows differ by roll x.
        zoom_px: it is larger; rows differ by zoom y.
        bend_px: its lens bends more; rows differ by bend y (x^2 + y^2).
        skew_px: rows differ by skew x y. A camera that looks sideways does that, but also a lens
            whose centre or tangential distortion is wrong, which errs otherwise along rows;
            so nothing is concluded from it (KITTI's cameras have 6 to 9 px).
    """

    pitch_px: float = 0.0
    roll_px: float = 0.0
    zoom_px: float = 0.0
    bend_px: float = 0.0
    skew_px: float = 0.0

    def vertical_px(self, x: Floats, y: Floats) -> Floats:
        """How much lower than expected a point is seen that should be at (x, y)."""
        rows = self.pitch_px * (1.0 + y * y) + self.roll_px * x + self.zoom_px * y
        return np.asarray(rows + self.bend_px * y * (x * x + y * y) + self.skew_px * x * y)

    def horizontal_px(self, x: Floats, y: Floats) -> Floats:
        """How much farther to the right, as far as rows tell."""
        columns = self.pitch_px * x * y - self.roll_px * y + self.zoom_px * x
        return np.asarray(columns + self.bend_px * x * (x * x + y * y))


class FittedVerticalDisparity(NamedTuple):
    """Errors of rows, and their covariance (5, 5)."""

    errors: VerticalDisparity
    covariance: Floats


class VerticalDisparityFit:
    """Gathers what pairs say of errors of rows."""

    def __init__(self) -> None:
        self._information = np.diag(_USUAL_PX**-2.0)
        self._vector = np.zeros(len(_USUAL_PX))

    def add(self, x: Floats, y: Floats, rows_px: Floats) -> Bools:
        """Take in a pair's points (N,), many of which may be wrong matches; which ones agree.

        Iteratively reweighted least squares with Cauchy weights, from the median on.
        """
        terms, usual = _terms(x, y), np.diag(_USUAL_PX**-2.0)
        found = np.array([median(rows_px), 0.0, 0.0, 0.0, 0.0])
        for _ in range(_ROUNDS):
            left = rows_px - terms @ found
            sigma = max(_NOISE_PX, 1.4826 * median(np.abs(left)))
            weight = 1.0 / (_TOGETHER * sigma**2 * (1.0 + (left / (2.0 * sigma)) ** 2))
            information, vector = (terms * weight[:, None]).T @ terms, terms.T @ (weight * rows_px)
            found = np.linalg.solve(information + usual, vector)
        self._information += information
        self._vector += vector
        return np.asarray(np.abs(rows_px - terms @ found) <= 3.0 * sigma)

    def result(self) -> FittedVerticalDisparity:
        """What all pairs together say."""
        covariance = np.asarray(np.linalg.inv(self._information), dtype=np.float64)
        return FittedVerticalDisparity(
            VerticalDisparity(*(covariance @ self._vector).tolist()), covariance
        )


def vertical_disparity_sigma(fitted: FittedVerticalDisparity, x: Floats, y: Floats) -> Floats:
    """Standard deviations of `rows_px` at some places."""
    terms = _terms(x, y)
    return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", terms, fitted.covariance, terms)))


def _terms(x: Floats, y: Floats) -> Floats:
    return np.stack([1.0 + y * y, x, y, y * (x * x + y * y), x * y], axis=-1)
