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


def rotation_errors_alone(estimate: Floats, reference: Floats) -> Floats:
    """Angles (N,) in degrees between poses (N, 4, 4) aligned by their rotations alone.

    Positions on a nearly straight path say little of the roll about it, so that an alignment by
    positions may turn all rotations by tens of degrees; this one has no such blind side.

    Source: Hartley et al., Rotation averaging, IJCV 103, 2013 (chordal L2 mean).
    """
    true, rotations = reference[:, :3, :3], estimate[:, :3, :3]
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", true, rotations))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation_angles_deg(np.swapaxes(true, 1, 2) @ turn @ rotations)
