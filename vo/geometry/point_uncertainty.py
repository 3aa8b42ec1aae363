"""How far positions of points can be trusted, from who sees them."""

from __future__ import annotations

import numpy as np

from vo.compiling.function import compiled
from vo.types import Floats, Ints


def position_sigma(
    points: Floats,
    centres: Floats,
    point: Ints,
    camera: Ints,
    disparity: Floats,
    sigma_px: Floats,
    sigma_disparity_px: float,
    focal_px: float,
    focal_baseline: float,
) -> Floats:
    """Standard deviation (M,) of points, all axes together, from cameras whose poses are exact.

    Args:
        points: (M, 3) in the world.
        centres: (K, 3) of the cameras, in the world.
        point: (N,) row in points of each observation.
        camera: (N,) row in centres of each observation.
        disparity: (N,) pixels, NaN where there is none.
        sigma_px: (N,) standard deviation of each observation across its ray.
        sigma_disparity_px: standard deviation of disparity.
        focal_px: focal length.
        focal_baseline: focal_px * baseline, 0 in mono.

    Returns:
        (M,); infinite where the observations do not tell the depth.
    """
    return np.asarray(
        _position_sigma(
            np.ascontiguousarray(points),
            np.ascontiguousarray(centres),
            point,
            camera,
            disparity,
            sigma_px,
            sigma_disparity_px,
            focal_px,
            focal_baseline,
        )
    )


@compiled
def _position_sigma(  # type: ignore[no-untyped-def]
    points, centres, point, camera, disparity, sigma_px, sigma_d, focal, fb
):
    # across * (I - r r^T) + along * r r^T, with r the unit ray, summed over each point's rays.
    information = np.zeros((len(points), 6))
    for n in range(len(point)):
        at, centre = points[point[n]], centres[camera[n]]
        x, y, z = at[0] - centre[0], at[1] - centre[1], at[2] - centre[2]
        squared = max(x * x + y * y + z * z, 1e-18)
        across = (focal / sigma_px[n]) ** 2 / squared
        along = 0.0 if np.isnan(disparity[n]) else (fb / sigma_d / squared) ** 2
        weight = (along - across) / squared
        told = information[point[n]]
        told[0] += across + weight * x * x
        told[1] += across + weight * y * y
        told[2] += across + weight * z * z
        told[3] += weight * x * y
        told[4] += weight * x * z
        told[5] += weight * y * z
    sigma = np.full(len(points), np.inf)
    for m in range(len(points)):
        xx, yy, zz, xy, xz, yz = information[m]
        minors = yy * zz - yz * yz + (xx * zz - xz * xz) + (xx * yy - xy * xy)
        determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        if determinant > 1e-9 * (xx + yy + zz) ** 3:
            sigma[m] = np.sqrt(minors / determinant)
    return sigma
