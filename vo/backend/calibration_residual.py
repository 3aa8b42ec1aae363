"""What a calibration leaves, seen in how the scene moves.

A stereo calibration that is off by a fraction of a pixel shifts every disparity by the same
amount, or by more towards the sides: near points are placed almost right, far ones too far or too
near. The way points move while the camera moves shows their depths up to one common scale, so
these can be told apart.

A lens that bends the image otherwise than its calibration says moves points towards the edges or
away from them. Seen from several sides no scene fits that: motion and points that agree in the
middle of the image do not at its edges. What of it looks like another motion stays unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.backend.bundle import NormalEquations
from vo.types import Floats

_UNDETERMINED = 1e-10  # eigenvalue, against the greatest, below which poses are left alone


class CalibrationResidual(NamedTuple):
    """What is left of an error of the calibration.

    Attributes:
        value: in stereo (2,) pixels that all disparities are too large by, and what they are too
            large by in addition at one focal length to the side of the image's middle, growing
            with the square of x on the right. In mono (1,) how much ideal points x, in focal
            lengths, are bent: they should lie at x (1 - value r^2).
        information: (2, 2) or (1, 1), the inverse of its covariance.
    """

    value: Floats
    information: Floats


def estimate_calibration_residual(
    normal: NormalEquations, unknowns: int
) -> CalibrationResidual | None:
    """Estimate it together with all poses but one and all points of a smoothed window.

    One Gauss-Newton step. None if the window does not determine it.

    Args:
        normal: the window's, with what the calibration leaves as the last rows.
        unknowns: how many these are.
    """
    if not np.isfinite(normal.hessian).all():
        return None
    poses, border = normal.hessian[:-unknowns, :-unknowns], normal.hessian[:-unknowns, -unknowns:]
    values, vectors = np.linalg.eigh(poses)
    determined = values > _UNDETERMINED * values[-1]  # all but the scale in mono
    with np.errstate(divide="ignore"):
        inverse = np.where(determined, 1.0 / values, 0.0)
    coupling = vectors.T @ border
    along = inverse[:, None] * coupling  # what poses would do about it
    information = normal.hessian[-unknowns:, -unknowns:] - along.T @ coupling
    gradient = normal.gradient[-unknowns:] - along.T @ (vectors.T @ normal.gradient[:-unknowns])
    if not (np.linalg.eigvalsh(information) > 0.0).all():
        return None
    return CalibrationResidual(np.asarray(-np.linalg.solve(information, gradient)), information)
