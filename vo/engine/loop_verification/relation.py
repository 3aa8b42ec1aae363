"""Relation of two keyframes from pairs of landmarks: by random samples, then least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.geometry.projection import MIN_DEPTH, Intrinsics, project, to_camera
from vo.base.geometry.quantiles import median
from vo.base.types import Bools, Floats
from vo.engine.geometry import sim3

_SAMPLE_RATIO, _MIN_SAMPLE_PX = 0.01, 4.0  # threshold of samples, ratio of the image width
_MIN_AREA = 1e-3  # of the triangle of a sample, relative to its longest side squared
_HUBER = 2.0
_ITERATIONS = 10
_MAX_LOG_SCALE = 5.0  # beyond, the pairs determine no scale
_CONVERGED = 1e-4  # squared Mahalanobis length of a step
_DEPTH_SIGMA = 0.05  # of the scale by the depths in both keyframes
_OPPOSITE = -np.eye(3)


class LandmarkPairs(NamedTuple):
    """N landmarks of two keyframes, in the frames (N, 3) and images (N, 2) of both.

    Attributes:
        earlier: (N, 3) in the frame of the earlier keyframe.
        earlier_sigma: (N,) standard deviations of the depths of `earlier`, relative.
    """

    earlier: Floats
    later: Floats
    earlier_xy: Floats
    later_xy: Floats
    earlier_sigma: Floats
    later_sigma: Floats
    sigma_px: Floats

    def select(self, chosen: Bools) -> LandmarkPairs:
        """Some of the pairs."""
        return LandmarkPairs(*(field[chosen] for field in self))

    def contiguous(self) -> LandmarkPairs:
        """The same as the kernels take them."""
        return LandmarkPairs(*(np.ascontiguousarray(field, np.float64) for field in self))


class Relation(NamedTuple):
    """Similarity earlier_from_later, and information (7, 7) in the frame of the later keyframe."""

    earlier_from_later: Floats
    information: Floats


def sample_relation(
    pairs: LandmarkPairs,
    cameras: tuple[Intrinsics, Intrinsics],
    width: int,
    *,
    with_scale: bool,
    seed: int,
    samples: int = 500,
) -> tuple[Floats, Bools]:
    """The relation, of random triples of pairs, that most pairs agree with; those pairs (N,).

    They agree in both images, to 1 % of the width of the later one, but at least 4 pixels.
    """
    count = len(pairs.earlier)
    threshold_px = max(_SAMPLE_RATIO * width, _MIN_SAMPLE_PX)
    rng = np.random.default_rng(seed)
    triples = (
        np.argsort(rng.random((samples, count)), axis=1)[:, :3]
        if count < 64
        else rng.integers(0, count, (samples, 3))
    )
    relations = _of_triples(pairs.earlier[triples], pairs.later[triples], with_scale)
    if len(relations) == 0:
        return np.eye(4), np.zeros(count, dtype=bool)
    back = sim3.inverse(relations)
    given = *pairs.contiguous()[:4], *cameras, threshold_px
    best = _best_of(relations, back, *given)
    return relations[best], _close_to(relations[best], back[best], *given)


@compiled
def _best_of(relations, back, earlier, later, earlier_xy, later_xy, camera_e, camera_l, limit):  # type: ignore[no-untyped-def]
    """Index of the relation (K, 4, 4) that most pairs agree with, the first of equals."""
    best, most = 0, -1
    for k in range(len(relations)):
        count = 0
        for n in range(len(earlier)):
            if count + len(earlier) - n <= most:
                break
            if _is_close(relations[k], later[n], earlier_xy[n], camera_e, limit) and _is_close(
                back[k], earlier[n], later_xy[n], camera_l, limit
            ):
                count += 1
        if count > most:
            best, most = k, count
    return best


@compiled
def _close_to(relation, back, earlier, later, earlier_xy, later_xy, camera_e, camera_l, limit):  # type: ignore[no-untyped-def]
    """(N,) pairs that agree with a relation."""
    result = np.empty(len(earlier), dtype=np.bool_)
    for n in range(len(earlier)):
        result[n] = _is_close(relation, later[n], earlier_xy[n], camera_e, limit) and _is_close(
            back, earlier[n], later_xy[n], camera_l, limit
        )
    return result


@compiled(**NO_REFCOUNT)
def _is_close(transform, point, xy, camera, limit):  # type: ignore[no-untyped-def]
    """Whether a moved point is projected within `limit` of a pixel."""
    x, y, z = to_camera(transform, point[0], point[1], point[2])
    if z < MIN_DEPTH:
        return False
    u, v = project(camera, x, y, z)
    du, dv = u - xy[0], v - xy[1]
    return du * du + dv * dv < limit * limit


def _of_triples(earlier: Floats, later: Floats, with_scale: bool) -> Floats:
    """(k, 4, 4) similarities of triples of points (K, 3, 3), without degenerate ones."""
    frame_e, area_e, side_e = _triad(earlier)
    frame_l, area_l, side_l = _triad(later)
    good = (area_e > _MIN_AREA * side_e**2) & (area_l > _MIN_AREA * side_l**2)
    ratio = side_e[good] / side_l[good]
    if with_scale:
        scale = ratio
    else:
        scale = np.ones(len(ratio))
        alike = (ratio > 0.7) & (ratio < 1.0 / 0.7)
        good[good] = alike
        scale = scale[alike]
    relations = np.zeros((len(scale), 4, 4))
    rotation = frame_e[good] @ np.swapaxes(frame_l[good], 1, 2)
    relations[:, :3, :3] = scale[:, None, None] * rotation
    centre = later[good].mean(axis=1)
    relations[:, :3, 3] = (
        earlier[good].mean(axis=1) - (relations[:, :3, :3] @ centre[:, :, None])[:, :, 0]
    )
    relations[:, 3, 3] = 1.0
    return relations


def _triad(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Orthonormal frames (K, 3, 3) of triangles, their areas (doubled) and sizes (K,).

    Source: Black, "A passive system for determining the attitude of a satellite", 1964 (TRIAD).
    """
    first, second = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normal = np.cross(first, second)
    area = np.linalg.norm(normal, axis=1)
    length = np.linalg.norm(first, axis=1)
    x = first / np.maximum(length, 1e-12)[:, None]
    z = normal / np.maximum(area, 1e-12)[:, None]
    frame = np.stack([x, np.cross(z, x), z], axis=2)
    spread = points - points.mean(axis=1, keepdims=True)
    return frame, area, np.sqrt((spread**2).sum(axis=(1, 2)))


def refine_relation(
    start: Floats,
    pairs: LandmarkPairs,
    cameras: tuple[Intrinsics, Intrinsics],
    *,
    with_scale: bool,
) -> Relation:
    """Minimise Huber-weighted reprojection errors in both images over the relation.

    The uncertainty of each landmark's depth is part of its error. Two keyframes at one point have
    the same image at any scale, so the ratio of depths is a weak observation of it. A relation
    whose scale diverges has no information.
    """
    relation, size = start.copy(), 7 if with_scale else 6
    pairs = pairs.contiguous()
    distance = np.linalg.norm(pairs.earlier, axis=1)
    for _ in range(_ITERATIONS):
        normal, right, _ = _normal_equations(relation, pairs, cameras, np.inf)
        normal[6, 6] += 1.0 / _DEPTH_SIGMA**2
        moved = pairs.later @ relation[:3, :3].T + relation[:3, 3]
        right[6] -= np.log(median(np.linalg.norm(moved, axis=1) / distance)) / _DEPTH_SIGMA**2
        step = np.zeros(7)
        damped = normal[:size, :size] + 1e-9 * np.diag(np.diag(normal)[:size] + 1e-9)
        step[:size] = np.linalg.solve(damped, right[:size])
        step[6] = np.clip(step[6], -1.0, 1.0)
        relation = relation @ sim3.retract(step)
        if abs(np.log(sim3.scale_of(relation))) > _MAX_LOG_SCALE:
            return Relation(relation, np.zeros((7, 7)))
        if step[:size] @ damped @ step[:size] < _CONVERGED:
            break
    normal, _, _ = _normal_equations(relation, pairs, cameras, 9.0)
    normal[6, 6] += 1.0 / _DEPTH_SIGMA**2
    return Relation(relation, normal)


def pair_errors(
    relation: Floats, pairs: LandmarkPairs, cameras: tuple[Intrinsics, Intrinsics]
) -> Floats:
    """(N,) squared errors of the pairs in standard deviations, the larger of both images."""
    return _normal_equations(relation, pairs.contiguous(), cameras, -np.inf)[2]


def _normal_equations(
    relation: Floats,
    pairs: LandmarkPairs,
    cameras: tuple[Intrinsics, Intrinsics],
    limit: float,
) -> tuple[Floats, Floats, Floats]:
    """J^T W J, -J^T W e, and squared errors, of both images.

    Errors of `limit` or more, squared, have no weight.
    """
    normal, right, squared = np.zeros((7, 7)), np.zeros(7), np.empty(len(pairs.earlier))
    motions = relation, sim3.inverse(relation), _OPPOSITE
    _add_pairs(motions, pairs, cameras, limit, normal, right, squared)
    return normal, right, squared


@compiled
def _add_pairs(motions, pairs, cameras, limit, normal, right, squared):  # type: ignore[no-untyped-def]
    """Sum the normal equations of all pairs; their squared errors, the larger of both images.

    relation @ exp(xi) moves a point p of the later frame by r x p + t + l p, and back(p) by the
    opposite.
    """
    relation, back, opposite = motions
    earlier, later, earlier_xy, later_xy, earlier_sigma, later_sigma, sigma_px = pairs
    rows, at = np.empty((2, 7)), np.empty(3)
    for n in range(len(earlier)):
        forward = _add_projection(
            *(relation, later[n], relation, later[n], earlier_xy[n], later_sigma[n]),
            *(sigma_px[n], cameras[0], limit, rows, normal, right),
        )
        at[0], at[1], at[2] = to_camera(back, earlier[n, 0], earlier[n, 1], earlier[n, 2])
        backward = _add_projection(
            *(back, earlier[n], opposite, at, later_xy[n], earlier_sigma[n]),
            *(sigma_px[n], cameras[1], limit, rows, normal, right),
        )
        squared[n] = max(forward, backward)


@compiled(**NO_REFCOUNT)
def _add_projection(  # type: ignore[no-untyped-def]
    transform, point, by_motion, at, xy, depth_sigma, sigma_px, camera, limit, rows, normal, right
):
    """Add the projection of a moved point; its squared error.

    by_motion (3, 3) is the derivative of the moved point by a motion of the later frame at `at`.
    """
    x, y, z = to_camera(transform, point[0], point[1], point[2])
    if z <= MIN_DEPTH:
        return np.inf
    u, v, fx, fy = x / z, y / z, camera.fx / z, camera.fy / z
    e0, e1 = camera.fx * u + camera.cx - xy[0], camera.fy * v + camera.cy - xy[1]
    # An error of the depth moves the point along its ray, and its projection by `a0`, `a1`.
    along = depth_sigma * (z - transform[2, 3])
    a0 = fx * (depth_sigma * (x - transform[0, 3]) - u * along)
    a1 = fy * (depth_sigma * (y - transform[1, 3]) - v * along)
    variance = sigma_px * sigma_px
    inner = variance * (variance + a0 * a0 + a1 * a1)
    w00, w01, w11 = 1 / variance - a0 * a0 / inner, -a0 * a1 / inner, 1 / variance - a1 * a1 / inner
    squared = w00 * e0 * e0 + 2 * w01 * e0 * e1 + w11 * e1 * e1
    if squared >= limit:
        return squared
    robust = min(1.0, _HUBER / np.sqrt(max(squared, 1e-12)))
    w00, w01, w11 = robust * w00, robust * w01, robust * w11
    for axis in range(3):
        rows[0, 3 + axis] = fx * (by_motion[0, axis] - u * by_motion[2, axis])
        rows[1, 3 + axis] = fy * (by_motion[1, axis] - v * by_motion[2, axis])
    for k in range(2):
        g0, g1, g2 = rows[k, 3], rows[k, 4], rows[k, 5]
        rows[k, 0] = g2 * at[1] - g1 * at[2]
        rows[k, 1] = g0 * at[2] - g2 * at[0]
        rows[k, 2] = g1 * at[0] - g0 * at[1]
        rows[k, 6] = g0 * at[0] + g1 * at[1] + g2 * at[2]
    for i in range(7):
        first = w00 * rows[0, i] + w01 * rows[1, i]
        second = w01 * rows[0, i] + w11 * rows[1, i]
        right[i] -= first * e0 + second * e1
        for j in range(7):
            normal[i, j] += first * rows[0, j] + second * rows[1, j]
    return squared
