"""Information of a window on its poses, points eliminated, with correlated errors.

The errors of aligned patches are small but not independent. A patch looks slightly different from
every new viewpoint, so that its aligned position drifts from keyframe to keyframe; its disparity
has nearly the same error everywhere. Independent errors would average out over a long track, which
these do not: docs/experiments/patch-error-correlation.md has the autocorrelation of residuals from
which this model is derived.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend import information_kernels
from vo.engine.backend.block_matrix import assembled
from vo.engine.backend.linearisation import Linearised

MIN_OBSERVATIONS = 3  # of a pose


class ErrorModel(NamedTuple):
    """Standard deviations of measurements, relative to those that the window uses as weights.

    Attributes:
        white: of a position, independent in each keyframe.
        creep: of the random walk of a position, per keyframe.
        disparity: of a disparity, independent in each keyframe.
        disparity_bias: of an error of a disparity that is the same in all keyframes.
    """

    white: float
    creep: float
    disparity: float
    disparity_bias: float


OF_PATCHES = ErrorModel(white=0.1, creep=0.2, disparity=0.25, disparity_bias=0.25)


def pose_information(
    linear: Linearised, scale: float, model: ErrorModel = OF_PATCHES, wanted: Bools | None = None
) -> Floats:
    """(6 K, 6 K) information on K poses, for covariances `scale` times those of the model.

    Points are eliminated by the Schur complement. 0 for poses with too few observations, and
    between two poses that are not `wanted` (K,).

    Source: Triggs et al., "Bundle Adjustment", 2000, sec. 6.1; of correlated observations
    generalised least squares (Aitken 1935).
    """
    count = linear.poses
    row, place = count * np.arange(count), np.arange(count)
    blocks = information_blocks(linear, row, place, model, wanted)
    information = assembled(blocks, row, 0, count, count)
    unknown = np.repeat(linear.seen < MIN_OBSERVATIONS, 6)
    information[unknown] = 0.0
    information[:, unknown] = 0.0
    return np.asarray(information / scale)


def information_blocks(
    linear: Linearised,
    row: Ints,
    place: Ints,
    model: ErrorModel = OF_PATCHES,
    wanted: Bools | None = None,
) -> Floats:
    """Its blocks, of scale 1; `place`: (K,) rows of the poses in the matrix."""
    return np.asarray(
        information_kernels.eliminated(
            row,
            place,
            linear.starts,
            linear.keyframe,
            linear.by_pose,
            linear.by_point,
            np.ones(linear.poses, dtype=bool) if wanted is None else wanted,
            *(sigma**2 for sigma in model),
        )
    )
