"""Points from matches of many views with known poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Camera, Floats, Ints

_MIN_VIEWS = 3
_MAX_ERROR_PX = (6.0, 3.0, 2.0)  # of an observation, in each round
_MIN_ANGLE_DEG = 8.0  # between the outermost rays


class Observations(NamedTuple):
    """N observations of points; rows belong together."""

    point: Ints  # (N,) numbers of points, from 0
    view: Ints  # (N,) numbers of views
    feature: Ints  # (N,) rows of the features of the view
    xy: Floats  # (N, 2) undistorted pixels

    def select(self, rows: Ints | Bools) -> Observations:
        """Some of them."""
        return Observations(self.point[rows], self.view[rows], self.feature[rows], self.xy[rows])


def tracks(begins: Ints, pairs: Sequence[tuple[Ints, Ints]]) -> Ints:
    """(N,) number of the point of each feature, -1 of features without a match.

    `begins`: (V + 1,) first feature of each view. `pairs`: features that match, numbered over all
    views. Matches that would give a point two features of one view are left out.
    """
    parent = np.arange(begins[-1])
    view = np.repeat(np.arange(len(begins) - 1), np.diff(begins))
    seen = [{number} for number in view.tolist()]

    def root(n: int) -> int:
        while parent[n] != n:
            parent[n] = parent[parent[n]]
            n = int(parent[n])
        return n

    for first, second in pairs:
        for a, b in zip(first.tolist(), second.tolist(), strict=True):
            a, b = root(a), root(b)
            if a != b and not seen[a] & seen[b]:
                parent[b] = a
                seen[a] |= seen[b]
    roots = np.array([root(n) for n in range(len(parent))])
    _, number, count = np.unique(roots, return_inverse=True, return_counts=True)
    return np.where(count[number] >= _MIN_VIEWS, number, -1)


def best_points(
    found: Observations, cam_from_world: Floats, camera: Camera
) -> tuple[Floats, Floats, Observations]:
    """Points (M, 3) in the world, NaN where there is none, with the observations that agree.

    Each is where its rays come nearest to each other, weighted by their distances, so that what is
    minimised is about the error in pixels. Between both are standard deviations (M,) along the
    least certain direction, that of depth, for errors of one pixel.
    """
    turn = cam_from_world[:, :3, :3].transpose(0, 2, 1)
    centres = -(turn @ cam_from_world[:, :3, 3, None])[:, :, 0]
    count = int(found.point.max(initial=-1)) + 1
    points, sigma = np.full((count, 3), np.nan), np.full(count, np.nan)
    for limit in _MAX_ERROR_PX:
        focal = np.array([camera.fx, camera.fy])
        plane = (found.xy - (camera.cx, camera.cy)) / focal
        ray = np.column_stack([plane, np.ones(len(plane))])
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        ray = (turn[found.view] @ ray[:, :, None])[:, :, 0]
        across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        weight = np.ones(len(ray))
        for _ in range(2):
            points, sigma = _nearest(found, across * weight[:, None, None], centres, count)
            away = np.linalg.norm(points[found.point] - centres[found.view], axis=1)
            weight = 1.0 / np.maximum(away, 1e-9) ** 2
        pose = cam_from_world[found.view]
        at = (pose[:, :3, :3] @ points[found.point][:, :, None])[:, :, 0] + pose[:, :3, 3]
        with np.errstate(invalid="ignore", divide="ignore"):
            error = np.linalg.norm((at[:, :2] / at[:, 2:] - plane) * focal, axis=1)
            good = (error <= limit) & (at[:, 2] > 0)
        good &= np.bincount(found.point[good], minlength=count)[found.point] >= _MIN_VIEWS
        good &= _is_wide(found.point, ray, good, count)
        found = found.select(good)
    return points, sigma / camera.fx, found


def _nearest(
    found: Observations, across: Floats, centres: Floats, count: int
) -> tuple[Floats, Floats]:
    """Points (M, 3) nearest to all of their rays, and their sigma (M,) for errors of a radian.

    NaN where rays are parallel, or none.
    """
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal, found.point, across)
    np.add.at(right, found.point, (across @ centres[found.view][:, :, None])[:, :, 0])
    size = np.trace(normal, axis1=1, axis2=2)
    good = np.linalg.det(normal) > 1e-9 * size**3
    points = np.full((count, 3), np.nan)
    points[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
    sigma = np.full(count, np.nan)
    sigma[good] = 1.0 / np.sqrt(np.linalg.eigvalsh(normal[good])[:, 0])
    return points, sigma


def _is_wide(point: Ints, ray: Floats, good: Bools, count: int) -> Bools:
    """(N,) whether the rays of the point differ enough, by their mean."""
    total = np.zeros((count, 3))
    np.add.at(total, point[good], ray[good])
    mean = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    cosine = np.ones(count)
    np.minimum.at(cosine, point[good], (ray[good] * mean[point[good]]).sum(axis=1))
    return np.asarray((cosine < np.cos(np.deg2rad(0.5 * _MIN_ANGLE_DEG)))[point])
