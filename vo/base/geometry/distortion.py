"""Lens models on normalised image points (x/z, y/z) or on directions, and their inverses.

A distortion polynomial is valid as far as it increases (its reach): beyond, rays at larger angles
would fall nearer to the centre. Rays beyond, and points without a ray, are NaN.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from vo.base.geometry import radtan_kernels
from vo.base.types import Bools, Camera, Floats

_MAX_ITERATIONS = 25
_CONVERGED = 1e-14
_BISECTIONS = 60
_ACCEPTED = 1e-9
"""Largest residual of an inverse in normalised units: a millionth of a pixel or less."""

_MAX_RADIUS = 20.0
"""tan of 87 degrees; a polynomial that increases up to here is taken to increase on."""


def distort_rays(camera: Camera, rays: Floats) -> Floats:
    """Distorted points (N, 2) of normalised points (N, 2); NaN beyond the reach of the lens."""
    match camera.distortion_model:
        case "none" | "radtan":
            return _radtan(camera.distortion, rays)
        case "equidistant":
            radius = np.hypot(rays[:, 0], rays[:, 1])
            angle = np.arctan(radius)
            return _equidistant(camera.distortion, rays, radius, angle, np.pi / 2)
        case _:
            return distort_directions(camera, np.column_stack([rays, np.ones(len(rays))]))


def undistort_rays(camera: Camera, moved: Floats) -> Floats:
    """Inverse of `distort_rays` on (N, 2); NaN where there is none."""
    match camera.distortion_model:
        case "none" | "radtan":
            return _radtan_inverse(camera.distortion, moved)
        case "equidistant":
            radius, angle = _equidistant_inverse(camera.distortion, moved, np.pi / 2)
            ratio = np.where(radius > 1e-9, np.tan(angle) / np.maximum(radius, 1e-300), 1.0)
            ratio[np.isnan(angle) | (angle >= np.pi / 2)] = np.nan
            return np.asarray(moved * ratio[:, None])
        case _:
            found = undistort_directions(camera, moved)
            return _divide(found[:, :2], found[:, 2], found[:, 2] > _MIN_Z)


def distort_directions(camera: Camera, directions: Floats) -> Floats:
    """Distorted points (N, 2) of directions (N, 3), behind the camera too; NaN beyond the reach."""
    x, y, z = directions.T
    match camera.distortion_model:
        case "equidistant":
            radius = np.hypot(x, y)
            angle = np.arctan2(radius, z)
            return _equidistant(camera.distortion, directions[:, :2], radius, angle, np.pi)
        case "double_sphere":
            return double_sphere(directions, *camera.distortion)
        case "extended_unified":
            return extended_unified(directions, *camera.distortion)
        case "omni":
            xi, *coefficients = camera.distortion
            return _radtan(tuple(coefficients), unified(directions, xi))
        case "equirectangular":
            return np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        case _:
            return distort_rays(camera, _divide(directions[:, :2], z, z > 0))


def undistort_directions(camera: Camera, moved: Floats) -> Floats:
    """Directions (N, 3) of any length of points (N, 2); NaN where there is none."""
    match camera.distortion_model:
        case "equidistant":
            radius, angle = _equidistant_inverse(camera.distortion, moved, np.pi)
            ratio = np.where(radius > 1e-9, np.sin(angle) / np.maximum(radius, 1e-300), 1.0)
            return np.column_stack([moved * ratio[:, None], np.cos(angle)])
        case "double_sphere":
            return double_sphere_inverse(moved, *camera.distortion)
        case "extended_unified":
            return extended_unified_inverse(moved, *camera.distortion)
        case "omni":
            xi, *coefficients = camera.distortion
            return unified_inverse(_radtan_inverse(tuple(coefficients), moved), xi)
        case "equirectangular":
            longitude, latitude = moved.T
            level = np.cos(latitude)
            level[(np.abs(longitude) > np.pi) | (level < 0.0)] = np.nan
            x, z = level * np.sin(longitude), level * np.cos(longitude)
            return np.column_stack([x, np.sin(latitude), z])
        case _:
            return np.column_stack([undistort_rays(camera, moved), np.ones(len(moved))])


def centre_scale(camera: Camera) -> float:
    """Magnification on the optical axis relative to a pinhole camera."""
    if camera.distortion_model in ("double_sphere", "omni"):
        return 1.0 / (1.0 + camera.distortion[0])
    return 1.0


@lru_cache(maxsize=16)
def angle_reach(coefficients: tuple[float, ...], most: float = np.pi / 2) -> float:
    """Maximum valid angle from the axis of an `equidistant` lens, at most `most`."""
    angles = np.linspace(0.0, most, 4001)
    _, slope = _angle_polynomial(coefficients, angles)
    folds = np.flatnonzero(slope <= 0)
    return float(angles[folds[0] - 1] if len(folds) else most)


@lru_cache(maxsize=16)
def radial_reach(coefficients: tuple[float, ...]) -> float:
    """Maximum valid radius of normalised points of a `radtan` lens; infinite if unlimited."""
    radii = np.linspace(0.0, _MAX_RADIUS, 20001)
    radial, slope = radtan_kernels.radial(_eight(coefficients), radii**2)
    # A rational model past its pole changes sign or jumps down.
    folds = np.flatnonzero(~(radial + 2.0 * radii**2 * slope > 0) | ~(radial > 0))
    return float(radii[folds[0] - 1]) if len(folds) else np.inf


def _radtan(coefficients: tuple[float, ...], rays: Floats) -> Floats:
    """Source: Brown, "Decentering Distortion of Lenses", 1966; the rational form is OpenCV's."""
    reach = radial_reach(coefficients)
    moved = radtan_kernels.distort(_eight(coefficients), np.ascontiguousarray(rays), reach)
    return np.asarray(moved)


def _radtan_inverse(coefficients: tuple[float, ...], moved: Floats) -> Floats:
    reach, k = radial_reach(coefficients), _eight(coefficients)
    moved = np.ascontiguousarray(moved)
    limits = _MAX_ITERATIONS, _CONVERGED, _ACCEPTED
    return np.asarray(radtan_kernels.undistort(k, moved, reach, *limits))


def _eight(coefficients: tuple[float, ...]) -> Floats:
    """k1, k2, p1, p2, k3, k4, k5, k6, with zeros for missing ones."""
    return np.array((*coefficients, *[0.0] * 8)[:8])


def _angle_polynomial(coefficients: tuple[float, ...], angle: Floats) -> tuple[Floats, Floats]:
    """Distorted radius of angles from the axis, and its derivative.

    Source: Kannala and Brandt, "A Generic Camera Model", 2006, eq. 6.
    """
    k1, k2, k3, k4 = coefficients
    a2 = angle * angle
    radius = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
    return radius, slope


def _equidistant(
    coefficients: tuple[float, ...], xy: Floats, radius: Floats, angle: Floats, most: float
) -> Floats:
    """Distorted points of (N, 2), at `radius` from the axis and `angle` to it."""
    moved, _ = _angle_polynomial(coefficients, angle)
    ratio = np.where(radius > 1e-9, moved / np.maximum(radius, 1e-300), 1.0)
    ratio[angle > angle_reach(coefficients, most)] = np.nan
    return np.asarray(xy * ratio[:, None])


def _equidistant_inverse(
    coefficients: tuple[float, ...], moved: Floats, most: float
) -> tuple[Floats, Floats]:
    """Radii of points (N, 2), and their angles up to `most`; NaN where there is none."""
    limit = angle_reach(coefficients, most)
    radius = np.hypot(moved[:, 0], moved[:, 1])
    angle = np.minimum(radius, limit)
    for _ in range(_MAX_ITERATIONS):
        found, slope = _angle_polynomial(coefficients, angle)
        step = (radius - found) / np.maximum(slope, 1e-12)
        angle = np.clip(angle + step, 0.0, limit)
        if not np.any(np.abs(step) > _CONVERGED):
            break
    found, _ = _angle_polynomial(coefficients, angle)
    # Where the slope of the polynomial changes much, Newton's steps may alternate.
    max_radius, _ = _angle_polynomial(coefficients, np.array(limit))
    failed = ~(np.abs(found - radius) <= _ACCEPTED)
    missed = failed & (radius <= max_radius)
    if missed.any():
        angle[missed] = _angle_by_bisection(coefficients, radius[missed], limit)
        failed &= ~missed
    return radius, np.where(failed, np.nan, angle)


def _angle_by_bisection(coefficients: tuple[float, ...], radius: Floats, limit: float) -> Floats:
    """Angles of distorted radii (N,), which increase up to the angle `limit`."""
    low, high = np.zeros(len(radius)), np.full(len(radius), limit)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_low = _angle_polynomial(coefficients, middle)[0] < radius
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return low


# Wide lenses as projections of a sphere: all map directions to points m of the image plane; a pixel
# is focal length * m + principal point.
_MIN_Z = 1e-9
"""cos of the maximum angle from the axis: at 90 degrees x/z is infinite."""


def double_sphere(directions: Floats, xi: float, alpha: float) -> Floats:
    """Points m (N, 2) of directions (N, 3).

    Source: Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 2018, eq. 40 to 45.
    """
    xy, z = directions[:, :2], directions[:, 2]
    r2 = np.sum(xy * xy, axis=1)
    d1 = np.sqrt(r2 + z * z)
    d2 = np.sqrt(r2 + (xi * d1 + z) ** 2)
    below = alpha * d2 + (1.0 - alpha) * (xi * d1 + z)
    w1 = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha  # eq. 45
    w2 = (w1 + xi) / np.sqrt(2.0 * w1 * xi + xi * xi + 1.0)  # eq. 44
    return _divide(xy, below, (below > 0) & (-w2 * d1 < z))  # eq. 43


def double_sphere_inverse(m: Floats, xi: float, alpha: float) -> Floats:
    """Directions (N, 3) of points m (N, 2): eq. 46 to 51 of the same paper."""
    r2 = np.sum(m * m, axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * r2)  # NaN outside, eq. 51
        mz = (1.0 - alpha * alpha * r2) / (alpha * root + 1.0 - alpha)  # eq. 50
        scale = (mz * xi + np.sqrt(mz * mz + (1.0 - xi * xi) * r2)) / (mz * mz + r2)
        z = scale * mz - xi
        found = np.column_stack([m * scale[:, None], np.where(scale > 0, z, np.nan)])
        # Beyond the limit of the lens (eq. 43) two rays have the same point; the wrong one does
        # not project back.
        again = double_sphere(found, xi, alpha)
    found[~np.isfinite(again).all(axis=1)] = np.nan
    return found


def extended_unified(directions: Floats, alpha: float, beta: float) -> Floats:
    """Points m (N, 2) of directions (N, 3).

    Source: Khomutenko, Garcia and Martinet, "An Enhanced Unified Camera Model", 2016; all rays in
    front of the camera are in its field of view, and some behind (Usenko et al. 2018, eq. 30).
    """
    xy, z = directions[:, :2], directions[:, 2]
    d = np.sqrt(beta * np.sum(xy * xy, axis=1) + z * z)
    w = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha
    below = alpha * d + z - alpha * z
    return _divide(xy, below, (below > 0) & (z > -w * d))


def extended_unified_inverse(m: Floats, alpha: float, beta: float) -> Floats:
    """Directions (N, 3) of points m (N, 2)."""
    r2 = np.sum(m * m, axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * beta * r2)
        z = (1.0 - beta * alpha * alpha * r2) / (alpha * root + 1.0 - alpha)
    return np.column_stack([m, z])


def unified(directions: Floats, xi: float) -> Floats:
    """Points m (N, 2) of directions (N, 3), before radial and tangential distortion.

    Source: Mei and Rives, "Single View Point Omnidirectional Camera Calibration from Planar Grids",
    2007, section II-B; beyond the limit two directions have the same point.
    """
    xy, z = directions[:, :2], directions[:, 2]
    d = np.sqrt(np.sum(xy * xy, axis=1) + z * z)
    return _divide(xy, z + xi * d, z > -min(xi, 1.0 / max(xi, 1e-300)) * d)


def unified_inverse(m: Floats, xi: float) -> Floats:
    """Directions (N, 3) of points m (N, 2)."""
    r2 = np.sum(m * m, axis=1)
    with np.errstate(invalid="ignore"):
        scale = (xi + np.sqrt(1.0 + (1.0 - xi * xi) * r2)) / (r2 + 1.0)
    return np.column_stack([m * scale[:, None], scale - xi])


def _divide(points: Floats, below: Floats, seen: Bools) -> Floats:
    """Points (N, 2) divided by (N,), NaN where not `seen`."""
    return np.asarray(points / np.where(seen, below, np.nan)[:, None])
