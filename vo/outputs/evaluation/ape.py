"""Absolute errors (ATE) of aligned poses."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats
from vo.outputs.evaluation.statistics import PoseErrors, relative_poses, rotation_angles_deg


def absolute_errors(estimate: Floats, reference: Floats) -> PoseErrors:
    """Errors of aligned poses (N, 4, 4) against reference poses (N, 4, 4) in the same world.

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012 (ATE).
    """
    offsets = estimate[:, :3, 3] - reference[:, :3, 3]
    rotations = relative_poses(reference, estimate)[:, :3, :3]
    return PoseErrors(np.linalg.norm(offsets, axis=1), rotation_angles_deg(rotations))


def rotation_errors_alone(estimate: Floats, reference: Floats) -> Floats:
    """Angles (N,) in degrees between poses (N, 4, 4) aligned by their rotations alone.

    On a nearly straight path, positions hardly determine the roll about it: an alignment by
    positions may be off by tens of degrees. An alignment by rotations is not affected.

    Source: Hartley et al., Rotation averaging, IJCV 103, 2013 (chordal L2 mean).
    """
    true, rotations = reference[:, :3, :3], estimate[:, :3, :3]
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", true, rotations))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation_angles_deg(np.swapaxes(true, 1, 2) @ rotation @ rotations)
