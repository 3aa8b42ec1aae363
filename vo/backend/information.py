"""What a window says of its poses, all else eliminated, with errors that last.

The errors of aligned patches are small but not independent. A patch looks a little different from
every new side, so that the place found for it creeps from keyframe to keyframe; its disparity is
off by about the same everywhere. Taken for independent they would average out over a long track,
and did not: see docs/accuracy.md for the autocorrelation of residuals that this model is drawn
from.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.backend import block_kernels
from vo.backend.linearisation import Linearised
from vo.types import Floats

_LEAST_OBSERVATIONS = 3  # below that a pose cannot be determined


class ErrorModel(NamedTuple):
    """Standard deviations of measurements, against those that the window weighs with.

    Attributes:
        white: of a position, by itself in each keyframe.
        creep: of a position, added from one keyframe to the next.
        disparity: of a disparity, by itself in each keyframe.
        disparity_bias: of a disparity, the same in all keyframes.
    """

    white: float
    creep: float
    disparity: float
    disparity_bias: float


OF_PATCHES = ErrorModel(white=0.1, creep=0.2, disparity=0.25, disparity_bias=0.25)


def pose_information(linear: Linearised, scale: float, model: ErrorModel = OF_PATCHES) -> Floats:
    """(6 K, 6 K) information on K poses, for covariances `scale` times those of the model.

    Points are eliminated by the Schur complement. 0 for poses with too few observations.

    Source: Triggs et al., "Bundle Adjustment", 2000, sec. 6.1; of correlated observations
    generalised least squares (Aitken 1935).
    """
    information = block_kernels.eliminated(
        linear.poses,
        linear.starts,
        linear.keyframe,
        linear.by_pose,
        linear.by_point,
        *(sigma**2 for sigma in model),
    )
    unknown = np.repeat(linear.seen < _LEAST_OBSERVATIONS, 6)
    information[unknown] = 0.0
    information[:, unknown] = 0.0
    return np.asarray(information / scale)
