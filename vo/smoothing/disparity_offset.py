"""A constant error of all disparities, seen in how the scene moves.

A stereo calibration that is off by a fraction of a pixel shifts every disparity by the same
amount: near points are placed almost right, far ones too far or too near. The way points move
while the camera moves shows their depths up to one common scale, so the two can be told apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.smoothing.bundle import NormalEquations


class DisparityOffset(NamedTuple):
    """Measured disparity = true disparity + `offset_px`, known to `sigma_px`."""

    offset_px: float
    sigma_px: float


def disparity_offset(normal: NormalEquations) -> DisparityOffset | None:
    """Estimate the offset together with all poses but one and all points of a smoothed window.

    One Gauss-Newton step. None if the window does not determine it.
    """
    try:
        covariance = np.linalg.inv(normal.hessian)
    except np.linalg.LinAlgError:
        return None
    offset, variance = float(-(covariance @ normal.gradient)[-1]), float(covariance[-1, -1])
    if not np.isfinite(offset) or not variance > 0:
        return None
    return DisparityOffset(offset, float(np.sqrt(variance)))
