"""Poses of a plane with known points, both of them, by the image of one camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.base.geometry.cameras import normalise
from vo.base.geometry.transforms import se3_exp, so3_log
from vo.base.types import Camera, Floats
from vo.tools.markers.image_markers import PlanePose

_MAX_ITERATIONS = 20
_CONVERGED = 1e-8  # squared length of a step, in standard deviations
_SAME_POSE_RAD = 0.02  # below this angle the two solutions are one
_ANY_PIXEL = 1e3  # in normalised coordinates: beyond every lens


def plane_pose(camera: Camera, points: Floats, pixels: Floats, sigma_px: float) -> PlanePose | None:
    """The pose of points of a plane, the better of the two that are possible; None where none fits.

    Points (N, 3) are in the plane z = 0, at least four; four around the origin must be those of
    `square_points`. Pixels (N, 2) are of the recorded image.

    Source: Collins and Bartoli, "Infinitesimal Plane-Based Pose Estimation", 2014, for both first
        guesses.
    """
    rays = _rays(camera, pixels)
    return None if rays is None else _best(camera, points, rays, sigma_px, _guesses(points, rays))


def pose_from(
    camera: Camera, points: Floats, pixels: Floats, sigma_px: float, guesses: Sequence[Floats]
) -> PlanePose | None:
    """The pose of any points (N, 3), the best that is near a guess (4, 4); None where none fits."""
    rays = _rays(camera, pixels)
    return None if rays is None else _best(camera, points, rays, sigma_px, guesses)


def _rays(camera: Camera, pixels: Floats) -> Floats | None:
    rays = normalise(camera, pixels)
    is_usable = np.isfinite(rays).all() and np.abs(rays).max() <= _ANY_PIXEL
    return rays if is_usable else None


def _best(
    camera: Camera, points: Floats, rays: Floats, sigma_px: float, guesses: Sequence[Floats]
) -> PlanePose | None:
    focal = np.array([camera.fx, camera.fy])
    candidates = [refined for guess in guesses if (refined := _refine(guess, points, rays, focal))]
    if not candidates:
        return None
    candidates.sort(key=lambda each: each[1])
    pose, cost, information = candidates[0]
    other, other_cost = None, np.inf
    for each, its_cost, _ in candidates[1:]:
        if np.linalg.norm(so3_log(each[:3, :3] @ pose[:3, :3].T)) > _SAME_POSE_RAD:
            other, other_cost = each, its_cost
            break
    rms = np.sqrt(np.array([cost, other_cost]) / len(points))
    covariance = np.asarray(sigma_px**2 * np.linalg.pinv(information, hermitian=True), np.float64)
    evidence = float((other_cost - cost) / sigma_px**2)
    return PlanePose(pose, covariance, float(rms[0]), other, float(rms[1]), evidence)


def _guesses(points: Floats, rays: Floats) -> list[Floats]:
    is_square = len(points) == 4 and np.abs(points.mean(axis=0)).max() < 1e-9
    method = cv2.SOLVEPNP_IPPE_SQUARE if is_square else cv2.SOLVEPNP_IPPE
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            points, rays[:, None], np.eye(3), None, flags=method
        )
    except cv2.error:  # corners on a line
        return []
    guesses = []
    for rotvec, translation in zip(rotations, translations, strict=True):
        guess = np.eye(4)
        guess[:3, :3], guess[:3, 3] = cv2.Rodrigues(rotvec)[0], translation.ravel()
        if np.isfinite(guess).all():
            guesses.append(guess)
    return guesses


def _refine(
    start: Floats, points: Floats, rays: Floats, focal: Floats
) -> tuple[Floats, float, Floats] | None:
    """Minimise the reprojection error; pose, squared error in pixels, J^T J (6, 6)."""
    pose = start
    found = _linearise(pose, points, rays, focal)
    damping = 1e-6
    for _ in range(_MAX_ITERATIONS):
        if found is None:
            return None
        cost, information, gradient = found
        damped = information + damping * np.diag(np.diag(information))
        step = np.asarray(np.linalg.lstsq(damped, -gradient, rcond=None)[0], np.float64)
        moved = se3_exp(step) @ pose
        trial = _linearise(moved, points, rays, focal)
        if trial is None or trial[0] > cost:
            damping *= 10.0
            continue
        pose, found, damping = moved, trial, max(0.1 * damping, 1e-9)
        if -gradient @ step < _CONVERGED:
            break
    return None if found is None else (pose, found[0], found[1])


def _linearise(
    pose: Floats, points: Floats, rays: Floats, focal: Floats
) -> tuple[float, Floats, Floats] | None:
    """Squared error in pixels, J^T J and J^T e; tangent of exp(xi) @ pose."""
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    if z.min() < 1e-6:
        return None
    u, v = x / z, y / z
    zero = np.zeros_like(u)
    rows = np.stack(
        [
            np.stack([-u * v, 1.0 + u * u, -v, 1.0 / z, zero, -u / z], axis=1) * focal[0],
            np.stack([-1.0 - v * v, u * v, u, zero, 1.0 / z, -v / z], axis=1) * focal[1],
        ],
        axis=1,
    ).reshape(-1, 6)
    error = ((np.stack([u, v], axis=1) - rays) * focal).ravel()
    return float(error @ error), rows.T @ rows, rows.T @ error
