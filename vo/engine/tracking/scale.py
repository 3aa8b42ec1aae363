"""Scale of a translation of known direction, from points of the map."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.types import Floats


def scale_from_points(
    now_from_last: Floats, points_last: Floats, rays_now: Floats, *, agreement: float = 0.3
) -> tuple[float, int]:
    """Scale of a unit translation, and how many points agree with it.

    Args:
        now_from_last: (4, 4) motion with a translation of length 1.
        points_last: (N, 3) map points in the last camera's frame.
        rays_now: (N, 2) where they are seen now, x/z and y/z.
        agreement: share by which a point's own scale may differ from the median.

    With q = R p and direction t, (q + s t) is parallel to the ray (x, y, 1), so each point gives
    s = (x q_z - q_x) / (t_x - x t_z), likewise in y; the two are joined by least squares.
    """
    q = points_last @ now_from_last[:3, :3].T
    t = now_from_last[:3, 3]
    slope = t[:2] - rays_now * t[2]
    offset = rays_now * q[:, 2:] - q[:, :2]
    weight = np.sum(slope**2, axis=1)
    usable = weight > 1e-12
    if not usable.any():
        return 0.0, 0
    scales = np.sum(slope * offset, axis=1)[usable] / weight[usable]
    scale = median(scales)
    if scale <= 0:
        return scale, 0
    return scale, int(np.sum(np.abs(scales - scale) <= agreement * scale))
