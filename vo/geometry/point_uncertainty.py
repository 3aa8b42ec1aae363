"""How far positions of points can be trusted, from who sees them."""

from __future__ import annotations

import numpy as np

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
    ray = points[point] - centres[camera]
    squared = np.maximum(np.einsum("ni,ni->n", ray, ray), 1e-18)
    across = (focal_px / sigma_px) ** 2 / squared
    along = np.where(np.isnan(disparity), 0.0, (focal_baseline / sigma_disparity_px / squared) ** 2)
    # across * (I - r r^T) + along * r r^T, with r the unit ray, summed over each point's rays.
    weight = (along - across) / squared
    x, y, z = ray.T
    terms = (
        across + weight * x * x,
        across + weight * y * y,
        across + weight * z * z,
        weight * x * y,
        weight * x * z,
        weight * y * z,
    )
    xx, yy, zz, xy, xz, yz = (np.bincount(point, term, minlength=len(points)) for term in terms)
    minors = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    determinant = xx * minors[0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    scale = np.maximum(xx + yy + zz, 1e-300)
    told = determinant > 1e-9 * scale**3
    variance = np.divide(sum(minors), determinant, out=np.full(len(points), np.inf), where=told)
    return np.asarray(np.sqrt(variance))
