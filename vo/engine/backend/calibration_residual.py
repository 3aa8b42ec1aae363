"""Estimation of the remaining calibration error from the motion of the scene.

A stereo calibration that is wrong by a fraction of a pixel adds a constant to all disparities, or
more towards the sides: near points are placed almost correctly, far points too far or too near.
The motion of points in the image shows their depths up to one common scale, so that the two can be
separated.

A wrong radial distortion moves points towards the image edges or away from them. Seen from several
viewpoints, no rigid scene explains that: motion and points that agree in the image centre disagree
at the edges. The component that is equivalent to another motion remains unknown.
"""

from __future__ import annotations

import numpy as np

from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.types import Floats
from vo.engine.backend.bundle import NormalEquations

_UNDETERMINED = 1e-10  # eigenvalue, relative to the greatest, below which a direction is fixed


def estimate_calibration_residual(
    normal: NormalEquations, size: int, check_size: int
) -> CalibrationResidual | None:
    """One Gauss-Newton step, with all poses but one and all points of an optimised window free.

    None if the window does not determine it.

    Args:
        normal: of the window, with those of the residual as the last rows.
        size: number of these rows.
        check_size: number of rows after them, for `CalibrationResidual.bend`.
    """
    if not np.isfinite(normal.hessian).all():
        return None
    poses = len(normal.hessian) - size - check_size
    values, vectors = np.linalg.eigh(normal.hessian[:poses, :poses])
    determined = values > _UNDETERMINED * values[-1]  # all but the scale in mono
    with np.errstate(divide="ignore"):
        inverse = np.where(determined, 1.0 / values, 0.0)

    def without_poses(size: int) -> tuple[Floats, Floats]:
        """Information and gradient of the first `size` parameters."""
        own = slice(poses, poses + size)
        coupling = vectors.T @ normal.hessian[:poses, own]
        along = inverse[:, None] * coupling  # compensation by the poses
        information = normal.hessian[own, own] - along.T @ coupling
        gradient = normal.gradient[own] - along.T @ (vectors.T @ normal.gradient[:poses])
        return information, gradient

    information, gradient = without_poses(size)
    if not (np.linalg.eigvalsh(information) > 0.0).all():
        return None
    found = CalibrationResidual(np.asarray(-np.linalg.solve(information, gradient)), information)
    return _with_bend(found, *without_poses(size + check_size)) if check_size else found


def _with_bend(
    found: CalibrationResidual, information: Floats, gradient: Floats
) -> CalibrationResidual:
    if not (np.linalg.eigvalsh(information) > 0.0).all():
        return found
    covariance = np.linalg.inv(information)
    bend = -float(covariance[-1] @ gradient)
    return found._replace(bend=bend, bend_sigma=float(np.sqrt(covariance[-1, -1])))
