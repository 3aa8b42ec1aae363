"""What a calibration leaves, seen in how the scene moves.

A stereo calibration that is off by a fraction of a pixel shifts every disparity by the same
amount: near points are placed almost right, far ones too far or too near. The way points move
while the camera moves shows their depths up to one common scale, so the two can be told apart.

A lens that bends the image otherwise than its calibration says moves points towards the edges or
away from them. Seen from several sides no scene fits that: motion and points that agree in the
middle of the image do not at its edges. What of it looks like another motion stays unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.smoothing.bundle import NormalEquations

_UNDETERMINED = 1e-10  # eigenvalue, against the greatest, below which poses are left alone


class Miscalibration(NamedTuple):
    """What is left of an error of the calibration, known to `sigma`.

    In stereo the pixels that all disparities are too large by. In mono how much ideal points x,
    in focal lengths, are bent: they should lie at x (1 - value r^2).
    """

    value: float
    sigma: float


def miscalibration(normal: NormalEquations) -> Miscalibration | None:
    """Estimate it together with all poses but one and all points of a smoothed window.

    One Gauss-Newton step. None if the window does not determine it.

    Args:
        normal: the window's, with what the calibration leaves as the last row.
    """
    if not np.isfinite(normal.hessian).all():
        return None
    poses, border = normal.hessian[:-1, :-1], normal.hessian[:-1, -1]
    values, vectors = np.linalg.eigh(poses)
    determined = values > _UNDETERMINED * values[-1]  # all but the scale in mono
    with np.errstate(divide="ignore"):
        inverse = np.where(determined, 1.0 / values, 0.0)
    along = inverse * (vectors.T @ border)  # what poses would do about it
    information = float(normal.hessian[-1, -1] - along @ (vectors.T @ border))
    gradient = float(normal.gradient[-1] - along @ (vectors.T @ normal.gradient[:-1]))
    if not np.isfinite(gradient) or not information > 0.0:
        return None
    return Miscalibration(-gradient / information, float(information**-0.5))
