"""Vertical disparity of a rectified pair as a function of the errors of the right camera.

In a rectified pair a point is in the same row of both images. If a camera was bumped, or its lens
refocused after calibration, rows differ, depending on the position in the image. Disparities are
wrong too, which cannot be observed: a roll by w adds w x to rows and w y to disparities.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.types import Bools, Floats

_ITERATIONS = 20
_MIN_SIGMA_PX = 0.1  # of rows, however well they fit
# Errors of neighbouring points are correlated: from frame to frame, fits to KITTI's cameras vary by
# five times the standard deviation for independent points. Factor for variances.
_CORRELATION = 25.0
# Prior standard deviations of the terms. A narrow lens hardly separates zoom from bend, and rarely
# has bend.
PRIOR_SIGMA_PX = np.array([5.0, 5.0, 5.0, 1.0, 5.0])
# Prior of the direction of the baseline, in radians: it moves rows in proportion to disparities,
# which on a road looks like zoom, and is no error of the right camera.
_SIGMA_TILT = 0.01


class VerticalDisparity(NamedTuple):
    """Errors of the right camera in pixels; x, y are normalised image coordinates.

    Attributes:
        pitch_px: rotation up or down; vertical disparity pitch (1 + y^2).
        roll_px: rotation about the optical axis; roll x.
        zoom_px: error of the focal length; zoom y.
        bend_px: error of the radial distortion; bend y (x^2 + y^2).
        skew_px: skew x y. Yaw causes it, but so do errors of the principal point and of tangential
            distortion, with other horizontal errors; so no horizontal error is derived from it
            (KITTI's cameras have 6 to 9 px).
    """

    pitch_px: float = 0.0
    roll_px: float = 0.0
    zoom_px: float = 0.0
    bend_px: float = 0.0
    skew_px: float = 0.0

    def vertical_px(self, x: Floats, y: Floats) -> Floats:
        """Vertical displacement of points at (x, y) in the right image, positive downwards."""
        rows = self.pitch_px * (1.0 + y * y) + self.roll_px * x + self.zoom_px * y
        return np.asarray(rows + self.bend_px * y * (x * x + y * y) + self.skew_px * x * y)

    def horizontal_px(self, x: Floats, y: Floats) -> Floats:
        """Horizontal displacement, positive to the right, as far as it follows from rows."""
        columns = self.pitch_px * x * y - self.roll_px * y + self.zoom_px * x
        return np.asarray(columns + self.bend_px * x * (x * x + y * y))


class FittedVerticalDisparity(NamedTuple):
    """Fitted errors and their covariance (5, 5)."""

    errors: VerticalDisparity
    covariance: Floats


class VerticalDisparityFit:
    """Robust least-squares fit of `VerticalDisparity` to the points of any number of pairs."""

    def __init__(self) -> None:
        self._prior = np.diag(np.append(PRIOR_SIGMA_PX, _SIGMA_TILT) ** -2.0)
        self._information = self._prior.copy()
        self._vector = np.zeros(len(self._prior))

    def add(self, x: Floats, y: Floats, vertical_px: Floats, disparity_px: Floats) -> Bools:
        """Add the points of a pair, many of which may be wrong matches.

        Iteratively reweighted least squares with Cauchy weights, starting from the median.

        Args:
            x: (N,) normalised image coordinates.
            y: (N,) the same.
            vertical_px: (N,) row in the right image minus row in the left.
            disparity_px: (N,) column in the left image minus column in the right.

        Returns:
            Mask (N,) of points within three standard deviations of the fit.
        """
        terms = np.column_stack([vertical_disparity_terms(x, y), disparity_px])
        found = np.array([median(vertical_px), 0.0, 0.0, 0.0, 0.0, 0.0])
        for _ in range(_ITERATIONS):
            residual = vertical_px - terms @ found
            sigma = max(_MIN_SIGMA_PX, 1.4826 * median(np.abs(residual)))
            weight = 1.0 / (_CORRELATION * sigma**2 * (1.0 + (residual / (2.0 * sigma)) ** 2))
            information, vector = (
                (terms * weight[:, None]).T @ terms,
                terms.T @ (weight * vertical_px),
            )
            found = np.linalg.solve(information + self._prior, vector)
        self._information += information
        self._vector += vector
        return np.asarray(np.abs(vertical_px - terms @ found) <= 3.0 * sigma)

    def support(self, x: Floats, y: Floats, vertical_px: Floats) -> float:
        """How much better the fit explains points that it does not contain than no error at all.

        Args:
            x: (N,) normalised image coordinates.
            y: (N,) the same.
            vertical_px: (N,) row in the right image minus row in the left.

        Returns:
            Difference of chi^2, with Cauchy's robust cost; negative if no error explains them
            better.
        """
        residual = vertical_px - self.result().errors.vertical_px(x, y)
        reach = 2.0 * max(_MIN_SIGMA_PX, 1.4826 * median(np.abs(residual)))
        cost, cost_without = (
            4.0 * np.log1p((each / reach) ** 2).sum() / _CORRELATION
            for each in (residual, vertical_px)
        )
        return float(cost_without - cost)

    def result(self) -> FittedVerticalDisparity:
        """Fit to all pairs."""
        covariance = np.asarray(np.linalg.inv(self._information), dtype=np.float64)
        errors = VerticalDisparity(*(covariance @ self._vector)[:-1].tolist())
        return FittedVerticalDisparity(errors, covariance[:-1, :-1])


def sigmas_px(covariance: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Standard deviations of displacements at (x, y), each (N,).

    Args:
        covariance: (5, 5) of the errors.
        x: (N,) normalised image coordinates.
        y: (N,) the same.

    Returns:
        Of `vertical_px`, of `vertical_px` without skew, and of `horizontal_px`, each (N,).
    """
    vertical, none = vertical_disparity_terms(x, y), np.zeros_like(x)
    without_skew = vertical * (1.0, 1.0, 1.0, 1.0, 0.0)
    horizontal = np.stack([x * y, -y, x, x * (x * x + y * y), none], axis=-1)
    first, second, third = (
        np.sqrt(np.einsum("ni,ij,nj->n", terms, covariance, terms))
        for terms in (vertical, without_skew, horizontal)
    )
    return first, second, third


def vertical_disparity_terms(x: Floats, y: Floats) -> Floats:
    """Derivatives (N, 5) of `VerticalDisparity.vertical_px` by its fields, at (x, y), each (N,)."""
    return np.stack([1.0 + y * y, x, y, y * (x * x + y * y), x * y], axis=-1)
