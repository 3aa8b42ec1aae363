"""Wide lenses as projections of a sphere: double sphere, extended unified, unified (omni).

All map rays, as normalised points (x/z, y/z) in front of the camera, to points m of the image
plane; a pixel is focal length * m + principal point. Points m without such a ray are NaN.
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Floats

_MIN_Z = 1e-9
"""cos of the maximum angle from the axis: at 90 degrees x/z is infinite."""


def double_sphere(rays: Floats, xi: float, alpha: float) -> Floats:
    """Points m (N, 2) of rays (N, 2).

    Source: Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 2018, eq. 40 to 45.
    """
    r2 = np.sum(rays * rays, axis=1)
    d1 = np.sqrt(r2 + 1.0)
    d2 = np.sqrt(r2 + (xi * d1 + 1.0) ** 2)
    below = alpha * d2 + (1.0 - alpha) * (xi * d1 + 1.0)
    w1 = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha  # eq. 45
    w2 = (w1 + xi) / np.sqrt(2.0 * w1 * xi + xi * xi + 1.0)  # eq. 44
    return _divide(rays, below, (below > 0) & (-w2 * d1 < 1.0))  # eq. 43


def double_sphere_inverse(m: Floats, xi: float, alpha: float) -> Floats:
    """Rays (N, 2) of points m (N, 2): eq. 46 to 51 of the same paper."""
    r2 = np.sum(m * m, axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * r2)  # NaN outside, eq. 51
        mz = (1.0 - alpha * alpha * r2) / (alpha * root + 1.0 - alpha)  # eq. 50
        scale = (mz * xi + np.sqrt(mz * mz + (1.0 - xi * xi) * r2)) / (mz * mz + r2)
        z = scale * mz - xi
        seen = (z > _MIN_Z) & (scale > 0)
    rays = _divide(m * scale[:, None], z, seen)
    # Beyond the limit of the lens (eq. 43) two rays have the same point; the wrong one does not
    # project back.
    again = double_sphere(np.where(np.isfinite(rays), rays, 0.0), xi, alpha)
    rays[~np.isfinite(again).all(axis=1)] = np.nan
    return rays


def extended_unified(rays: Floats, alpha: float, beta: float) -> Floats:
    """Points m (N, 2) of rays (N, 2).

    Source: Khomutenko, Garcia and Martinet, "An Enhanced Unified Camera Model", 2016; all rays in
    front of the camera are in its field of view.
    """
    r2 = np.sum(rays * rays, axis=1)
    below = alpha * np.sqrt(beta * r2 + 1.0) + 1.0 - alpha
    return np.asarray(rays / below[:, None])


def extended_unified_inverse(m: Floats, alpha: float, beta: float) -> Floats:
    """Rays (N, 2) of points m (N, 2)."""
    r2 = np.sum(m * m, axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * beta * r2)
        z = (1.0 - beta * alpha * alpha * r2) / (alpha * root + 1.0 - alpha)
        seen = z > _MIN_Z
    return _divide(m, z, seen)


def unified(rays: Floats, xi: float) -> Floats:
    """Points m (N, 2) of rays (N, 2), before radial and tangential distortion.

    Source: Mei and Rives, "Single View Point Omnidirectional Camera Calibration from Planar Grids",
    2007, section II-B.
    """
    d = np.sqrt(np.sum(rays * rays, axis=1) + 1.0)
    return np.asarray(rays / (1.0 + xi * d)[:, None])


def unified_inverse(m: Floats, xi: float) -> Floats:
    """Rays (N, 2) of points m (N, 2)."""
    r2 = np.sum(m * m, axis=1)
    with np.errstate(invalid="ignore"):
        scale = (xi + np.sqrt(1.0 + (1.0 - xi * xi) * r2)) / (r2 + 1.0)
        z = scale - xi
        seen = z > _MIN_Z
    return _divide(m * scale[:, None], z, seen)


def _divide(points: Floats, below: Floats, seen: Bools) -> Floats:
    """Points (N, 2) divided by (N,), NaN where not `seen`."""
    return np.asarray(points / np.where(seen, below, np.nan)[:, None])
