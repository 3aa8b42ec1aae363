"""Choice between an essential or fundamental matrix and a homography of the same matches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.types import Bools, Floats
from vo.tools.pairs.two_view_fit import fit_essential, fit_fundamental, fit_homography
from vo.tools.pairs.two_view_records import Fit, FitFailure, FitOptions, ModelKind

# Dimension of the variety that a model restricts matches to, and its number of parameters.
_DIMENSION = {ModelKind.FUNDAMENTAL: 3, ModelKind.ESSENTIAL: 3, ModelKind.HOMOGRAPHY: 2}
_PARAMETERS = {ModelKind.FUNDAMENTAL: 7, ModelKind.ESSENTIAL: 5, ModelKind.HOMOGRAPHY: 8}
_COORDINATES = 4  # of a match
_OUTLIER = 2.0  # Torr's lambda_3
_SIGMAS = 1.96  # the threshold in standard deviations: 95 % of the distances from a line


def fit_best(
    first: Floats,
    second: Floats,
    matrices: tuple[Floats, Floats] | None,
    options: FitOptions = FitOptions(),  # noqa: B008 - immutable
    quality: Floats | None = None,
) -> Fit | FitFailure:
    """The model that explains matches best.

    Of a homography and an essential matrix, or, without calibration, a fundamental matrix.

    `first`: (N, 2) pixels without lens distortion; rows with NaN are left out. `second`: (N, 2) the
    same in the second image. `matrices`: (3, 3) camera matrices of both images, None if they are
    unknown. `quality`: (N,) lower is better, such as the distances of the descriptors, for PROSAC.
    """
    if matrices is None:
        lines = fit_fundamental(first, second, options, quality)
    else:
        lines = fit_essential(first, second, matrices, options, quality)
    plane = fit_homography(first, second, options, quality)
    if isinstance(lines, FitFailure) and isinstance(plane, FitFailure):
        return lines
    # Where one model is beyond chance the images are related, and the other one may be better.
    fits = [each if isinstance(each, Fit) else each.refused for each in (lines, plane)]
    return select_model([fit for fit in fits if fit is not None], options.threshold_px)


def select_model(fits: Sequence[Fit], threshold_px: float) -> Fit:
    """The model with the lowest GRIC over the matches that any of them explains."""
    explained = np.logical_or.reduce([fit.inlier for fit in fits])
    return min(fits, key=lambda fit: gric(fit, explained, threshold_px))


def gric(fit: Fit, rows: Bools, threshold_px: float) -> float:
    """Geometric robust information criterion of a model; lower is better.

    Wrong matches would speak against the model of fewer dimensions, so they are left out.

    Source: Torr, "An assessment of information criteria for motion model selection", CVPR 1997,
    with the weights of Torr, "Geometric motion segmentation and model selection", 1998.

    `rows`: (N,) matches to explain, the same for all models that are compared. `threshold_px`:
    maximum Sampson distance of an inlier.
    """
    dimension, count = _DIMENSION[fit.kind], int(rows.sum())
    squared = (fit.error_px[rows] * _SIGMAS / threshold_px) ** 2
    limited = np.minimum(squared, _OUTLIER * (_COORDINATES - dimension)).sum()
    complexity = np.log(_COORDINATES) * dimension * count
    parameters = np.log(_COORDINATES * max(count, 1)) * _PARAMETERS[fit.kind]
    return float(limited + complexity + parameters)
