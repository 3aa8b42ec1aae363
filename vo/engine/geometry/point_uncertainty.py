"""Standard deviation of points from their observations, with exact poses."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Floats, Ints


def position_sigma(
    points: Floats,
    centres: Floats,
    point: Ints,
    camera: Ints,
    disparity: Floats,
    sigma_px: Floats,
    focal_px: float,
    focal_baseline: float,
) -> Floats:
    """Standard deviation (M,) of points in metres: the root of the trace of their covariance.

    N observations by rows of points (M, 3), -1 for none of them, and of camera centres (K, 3) in
    the world, taken to be near the principal point; disparities (N,) are NaN where there are none;
    `focal_baseline` is in m and standard deviations of a disparity, 0 in mono.

    Returns:
        (M,); infinite where the observations do not determine the depth.
    """
    return np.asarray(
        _position_sigma(
            np.ascontiguousarray(points),
            np.ascontiguousarray(centres),
            point,
            camera,
            disparity,
            sigma_px,
            focal_px,
            focal_baseline,
        )
    )


@compiled
def _position_sigma(  # type: ignore[no-untyped-def]
    points, centres, point, camera, disparity, sigma_px, focal, fb
):
    # The information of a ray with unit direction r is across * (I - r r^T) + along * r r^T. The
    # sum for each point is stored as xx, yy, zz, xy, xz, yz.
    information = np.zeros((len(points), 6))
    for n in range(len(point)):
        if point[n] < 0:
            continue
        at, centre = points[point[n]], centres[camera[n]]
        x, y, z = at[0] - centre[0], at[1] - centre[1], at[2] - centre[2]
        squared = max(x * x + y * y + z * z, 1e-18)
        across = (focal / sigma_px[n]) ** 2 / squared
        along = 0.0 if np.isnan(disparity[n]) else (fb / squared) ** 2
        weight = (along - across) / squared
        total = information[point[n]]
        total[0] += across + weight * x * x
        total[1] += across + weight * y * y
        total[2] += across + weight * z * z
        total[3] += weight * x * y
        total[4] += weight * x * z
        total[5] += weight * y * z
    sigma = np.full(len(points), np.inf)
    for m in range(len(points)):
        xx, yy, zz, xy, xz, yz = information[m]
        # The trace of the inverse is the sum of the principal minors over the determinant.
        minors = yy * zz - yz * yz + (xx * zz - xz * xz) + (xx * yy - xy * xy)
        determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        if determinant > 1e-9 * (xx + yy + zz) ** 3:
            sigma[m] = np.sqrt(minors / determinant)
    return sigma
