"""Measured depth as the disparity to a virtual right camera."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Floats, Floats32

# Maximum ratio of the largest to the smallest depth around a pixel; a larger one is an edge.
_MAX_SPREAD = 1.05


def disparity_from_depth(depth: Floats32, image_xy: Floats, rig: RectifiedRig) -> Floats:
    """Disparity (n,) in pixels at image pixels (n, 2), NaN where depth is unknown.

    Landmarks, residuals and windows treat it like a stereo disparity. Between pixels inverse depth
    is interpolated, which is exact on planes; at edges there is none, as both sides are possible.

    Args:
        depth: (H, W) metres along the optical axis, 0 where unknown.
        image_xy: (n, 2) pixels.
        rig: the rectified camera with its virtual baseline.

    Source: Mur-Artal and Tardos, ORB-SLAM2, 2017, eq. 1.
    """
    height, width = depth.shape
    corner = np.floor(image_xy).astype(np.int64)
    inside = np.asarray((corner >= 0).all(axis=1) & (corner < (width - 1, height - 1)).all(axis=1))
    u, v = np.where(inside[:, None], corner, 0).T
    around = np.stack([depth[v, u], depth[v, u + 1], depth[v + 1, u], depth[v + 1, u + 1]])
    around = around.astype(np.float64)
    nearest, farthest = around.min(axis=0), around.max(axis=0)
    known = inside & (nearest > 0.0) & (farthest < _MAX_SPREAD * nearest)
    fraction = image_xy - corner
    across, down = fraction[:, 0], fraction[:, 1]
    weights = np.stack(
        [(1 - across) * (1 - down), across * (1 - down), (1 - across) * down, across * down]
    )
    inverse_depth = (weights / np.where(around > 0.0, around, 1.0)).sum(axis=0)
    return np.where(known, rig.fx * rig.baseline_m * inverse_depth, np.nan)
