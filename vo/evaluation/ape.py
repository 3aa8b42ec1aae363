"""Absolute errors (ATE): how far each pose is from its true partner, after alignment."""

from __future__ import annotations

import numpy as np

from vo.evaluation.statistics import PoseErrors, relative, rotation_angles_deg
from vo.types import Floats


def absolute_errors(estimate: Floats, reference: Floats) -> PoseErrors:
    """Errors of aligned poses (N, 4, 4) against their partners (N, 4, 4) in the same world.

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012 (ATE).
    """
    offsets = estimate[:, :3, 3] - reference[:, :3, 3]
    rotations = relative(reference, estimate)[:, :3, :3]
    return PoseErrors(np.linalg.norm(offsets, axis=1), rotation_angles_deg(rotations))
