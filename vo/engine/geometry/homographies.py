"""Warps of patches by homographies, as planes look in two views.

An affine warp leaves out that the magnification changes across a patch. On ground and walls that a
camera moves along, and near the edges of views that look to different sides, this moves aligned
patches by up to 0.1 pixels, always to the same side, which changes the scale of a rig.
"""

from __future__ import annotations

import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.types import Floats

_MIN_DEPTH_RATIO = 0.1  # of depths in the reference and in the target
_MAX_CHANGE = 0.06  # of the depth, from pixel to pixel


def homographies(
    affine: Floats,
    xy: Floats,
    depth_by_target: Floats,
    inverse_depth: Floats,
    slope: Floats,
    intrinsics: Intrinsics,
) -> Floats:
    """Affine warps (N, 2, 2) to the reference with a third row c.

    An offset d of pixels in the target is A d / (1 + c d) in the reference, where c is the gradient
    of the depth there, relative to it, per depth in the target.

    Args:
        affine: A.
        xy: (N, 2) pixels in the target.
        depth_by_target: (N, 4) depth in the reference of a point (x, y, z, 1) in the target.
        inverse_depth: (N,) in the target.
        slope: (N, 2) of it, relative to it, 1/px.
        intrinsics: of both views.
    """
    focal, centre = np.array(intrinsics[:2]), np.array(intrinsics[2:])
    across, along = depth_by_target[:, :2], depth_by_target[:, 3] * inverse_depth
    depth = ((xy - centre) / focal * across).sum(axis=1) + depth_by_target[:, 2] + along
    gradient = across / focal + along[:, None] * slope
    change = np.nan_to_num(gradient / np.maximum(depth, _MIN_DEPTH_RATIO)[:, None])
    row = np.clip(change, -_MAX_CHANGE, _MAX_CHANGE)
    return np.concatenate([affine, row[:, None]], axis=1)
