"""Points from two views."""

from __future__ import annotations

import numpy as np

from vo.types import Bools, Floats


def triangulate(
    second_from_first: Floats, rays_first: Floats, rays_second: Floats
) -> tuple[Floats, Floats]:
    """Points (N, 3) in the first camera's frame, and the angles (N,) between their rays in rad.

    Args:
        second_from_first: (4, 4).
        rays_first: (N, 2) normalised image points (x/z, y/z).
        rays_second: (N, 2) the same in the second view.

    The point is the middle of the shortest line between the two rays (Hartley and Sturm, 1997,
    call it the mid-point method), which needs no SVD; the smoother refines it. Depths may come
    out negative: check them. Rays that are parallel give infinite points.
    """
    ones = np.ones((len(rays_first), 1))
    rotation, translation = second_from_first[:3, :3], second_from_first[:3, 3]
    d1 = np.hstack([rays_first, ones])
    d1 /= np.linalg.norm(d1, axis=1, keepdims=True)
    d2 = np.hstack([rays_second, ones]) @ rotation  # in the first frame
    d2 /= np.linalg.norm(d2, axis=1, keepdims=True)
    centre = -rotation.T @ translation
    cosine = np.sum(d1 * d2, axis=1)
    sine_squared = np.sum(np.cross(d1, d2) ** 2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along1 = ((d1 @ centre) - cosine * (d2 @ centre)) / sine_squared
        along2 = (cosine * (d1 @ centre) - (d2 @ centre)) / sine_squared
        points = 0.5 * (d1 * along1[:, None] + centre + d2 * along2[:, None])
    points[~np.isfinite(points).all(axis=1)] = np.inf
    return points, np.arctan2(np.sqrt(sine_squared), cosine)


def in_front(points: Floats, second_from_first: Floats) -> Bools:
    """Mask (N,) of points (N, 3) of the first frame that lie before both cameras."""
    with np.errstate(invalid="ignore"):
        depth_second = points @ second_from_first[2, :3] + second_from_first[2, 3]
        return np.asarray((points[:, 2] > 0) & (depth_second > 0) & np.isfinite(depth_second))
