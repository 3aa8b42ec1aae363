"""Instances of a flat side in a scene: homographies, one after the other.

Each instance takes its features with it, so that the next one is found among the rest (sequential
RANSAC).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Bools, Bytes, Floats, Floats32, Ints
from vo.engine.geometry.epipolar import transferred
from vo.tools.objects.appearance import likeness
from vo.tools.objects.part_matching import PartMatches, PartVectors, common_motion
from vo.tools.objects.scene_features import SceneFeatures
from vo.tools.objects.stored_objects import Part
from vo.tools.pairs.sampson import point_errors

MIN_INLIERS = 5
_MIN_MATCHES = 4
_THRESHOLD_PX = 3.0
_MAX_INSTANCES = 20  # of one side in one image
_MAX_FAILURES = 3  # groups of matches without a homography before the search ends
_REACH_PX = 3.0  # of a feature from where the homography predicts it
_REACH = 0.015  # the same, of the size of the object in the scene
_GUIDED_BINARY, _GUIDED = 0.8, 0.45  # maximum squared distance where the place is predicted
_SCALES = (0.05, 20.0)  # plausible sizes relative to the stored image
_MAX_STRETCH = 6.0  # ratio of both singular values of the local affine map
_ROUNDS = 2
_MAX_ITERATIONS = 2000
_MIN_DETERMINANT = 1e-9
_PLACE_PX = 1.0  # features nearer than this are at the same place


class FlatInstance(NamedTuple):
    """An instance of a flat side."""

    homography: Floats  # (3, 3) pixels of the stored image to those of the scene
    outline: Floats  # (4, 2) pixels of its corners
    inliers: int  # matches at different places that agree
    coverage: float  # ratio of the side inside the hull of these
    likeness: float  # ratio of the side's cells that look like the scene
    matches: PartMatches


def flat_instances(
    image: Bytes,
    scene: SceneFeatures,
    part: Part,
    vectors: PartVectors,
    matches: PartMatches,
) -> Iterator[FlatInstance]:
    """All instances of a flat side, the one with most matches first."""
    left = matches
    failures = found = 0
    while failures < _MAX_FAILURES and found < _MAX_INSTANCES and len(left.scene) >= _MIN_MATCHES:
        rows = common_motion(scene, vectors, left)
        alike = left if rows is None else left.select(rows)
        if len(alike.scene) < _MIN_MATCHES:
            return
        first, second = _pixels(scene, vectors, alike)
        homography = _robust(first, second)
        instance = None
        if homography is not None:
            instance = _grown(image, scene, part, vectors, homography)
        if instance is None:
            failures += 1
            if rows is None:
                return
            left = left.select(~np.isin(left.scene, alike.scene))
            continue
        found += 1
        yield instance
        inside = inside_outline(instance.outline, scene.xy[left.scene].astype(np.float64))
        left = left.select(~(inside | np.isin(left.scene, instance.matches.scene)))


def _grown(
    image: Bytes, scene: SceneFeatures, part: Part, vectors: PartVectors, homography: Floats
) -> FlatInstance | None:
    """The instance with all matches that its homography predicts; None if it is none."""
    outline = part.outline.astype(np.float64)
    for number in range(_ROUNDS):
        if not is_plausible(homography, outline):
            return None
        pairs = _predicted(scene, part, vectors, homography)
        first, second = _pixels(scene, vectors, pairs)
        # The first model is rough, so that right matches may be far from it.
        found = _robust(first, second) if number == 0 else homography
        for _ in range(_ROUNDS):
            if found is None:
                return None
            inlier = point_errors(found, first, second) <= _THRESHOLD_PX
            if np.count_nonzero(inlier) < MIN_INLIERS:
                return None
            found = _least_squares(first[inlier], second[inlier])
        if found is None:
            return None
        homography = found
        pairs = pairs.select(inlier)
    if not is_plausible(homography, outline):
        return None
    first, _ = _pixels(scene, vectors, pairs)
    return FlatInstance(
        homography / homography[2, 2],
        transferred(homography, outline),
        len(pairs.scene),
        coverage(first, outline),
        likeness(image, part, homography),
        pairs,
    )


def _predicted(
    scene: SceneFeatures, part: Part, vectors: PartVectors, homography: Floats
) -> PartMatches:
    """One-to-one matches near where a homography predicts the part's features, nearest first."""
    at = transferred(homography, vectors.xy.astype(np.float64))
    outline = transferred(homography, part.outline.astype(np.float64))
    reach = max(_REACH_PX, _REACH * float(np.sqrt(max(_area(outline), 1.0))))
    row, column = near(scene.xy, at, reach)
    product = (scene.vector[row] * vectors.vector[column]).sum(axis=1)
    distance = 2.0 - 2.0 * product
    limit = _GUIDED_BINARY if part.descriptor.dtype == np.uint8 else _GUIDED
    good = np.flatnonzero(distance <= limit)
    good = good[np.argsort(distance[good], kind="stable")]
    row, column, distance = row[good], column[good], distance[good]
    kept = first_of_each_place(scene.xy[row], vectors.xy[column])
    return PartMatches(row[kept], column[kept], distance[kept])


def near(scene_xy: Floats32, at: Floats, reach: float) -> tuple[Ints, Ints]:
    """Rows of the scene's features (N, 2) and of places (M, 2) that are within a square."""
    order = np.argsort(scene_xy[:, 0], kind="stable")
    u = scene_xy[order, 0]
    begin, end = np.searchsorted(u, at[:, 0] - reach), np.searchsorted(u, at[:, 0] + reach, "right")
    count = end - begin
    column = np.repeat(np.arange(len(at)), count)
    within = np.arange(len(column)) - np.repeat(np.cumsum(count) - count, count)
    row = order[np.repeat(begin, count) + within]
    close = np.abs(scene_xy[row, 1] - at[column, 1]) <= reach
    return row[close], column[close]


@compiled
def first_of_each_place(scene_xy, part_xy):  # type: ignore[no-untyped-def]
    """Rows, in order, whose place is taken by no row before: in the scene and in the part."""
    rows = np.empty(len(scene_xy), dtype=np.int64)
    count = 0
    for n in range(len(scene_xy)):
        is_free = True
        for k in rows[:count]:
            if _is_near(scene_xy, k, n) or _is_near(part_xy, k, n):
                is_free = False
                break
        if is_free:
            rows[count] = n
            count += 1
    return rows[:count]


@compiled(**NO_REFCOUNT)
def _is_near(xy, i, j):  # type: ignore[no-untyped-def]
    return abs(xy[i, 0] - xy[j, 0]) < _PLACE_PX and abs(xy[i, 1] - xy[j, 1]) < _PLACE_PX


def _pixels(
    scene: SceneFeatures, vectors: PartVectors, matches: PartMatches
) -> tuple[Floats, Floats]:
    first = vectors.xy[matches.part].astype(np.float64)
    return first, scene.xy[matches.scene].astype(np.float64)


def _robust(first: Floats, second: Floats) -> Floats | None:
    """Homography (3, 3) of pixels (N, 2), some of which are wrong; None if there is none."""
    if len(first) < _MIN_MATCHES:
        return None
    try:
        # OpenCV's USAC draws the same samples each time.
        found = cv2.findHomography(
            first, second, cv2.USAC_MAGSAC, _THRESHOLD_PX, maxIters=_MAX_ITERATIONS
        )[0]
    except cv2.error:  # degenerate points
        return None
    return _usable(found)


def _least_squares(first: Floats, second: Floats) -> Floats | None:
    """Homography (3, 3) with the least squared errors in the scene; None if there is none."""
    try:
        return _usable(cv2.findHomography(first, second, 0)[0])
    except cv2.error:  # degenerate points
        return None


def _usable(found: Any) -> Floats | None:
    if found is None or not np.isfinite(found).all():
        return None
    if abs(float(np.linalg.det(found))) < _MIN_DETERMINANT or found[2, 2] == 0:
        return None
    return np.asarray(found, dtype=np.float64)


def is_plausible(homography: Floats, outline: Floats) -> bool:
    """Whether a camera may see a side with an outline (4, 2) so: from its front, of some size."""
    depth = np.column_stack([outline, np.ones(len(outline))]) @ homography[2]
    if not (np.sign(depth) == np.sign(depth[0])).all() or np.abs(depth).min() <= 0:
        return False
    seen = transferred(homography, outline)
    if not np.isfinite(seen).all() or not cv2.isContourConvex(seen.astype(np.float32)):
        return False
    for point in (*outline, outline.mean(axis=0)):
        small = point + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        at = transferred(homography, small)
        jacobian = np.column_stack([at[1] - at[0], at[2] - at[0]])
        if not np.isfinite(jacobian).all() or np.linalg.det(jacobian) <= 0:
            return False
        large, least = np.linalg.svd(jacobian, compute_uv=False)
        if not _SCALES[0] <= least <= large <= _SCALES[1] or large > _MAX_STRETCH * least:
            return False
    return True


def coverage(xy: Floats, outline: Floats) -> float:
    """Area of the convex hull of points (N, 2) relative to that of an outline."""
    if len(xy) < 3:
        return 0.0
    hull = cv2.convexHull(xy.astype(np.float32))
    return min(float(cv2.contourArea(hull)) / max(_area(outline), 1e-9), 1.0)


def inside_outline(outline: Floats, xy: Floats) -> Bools:
    """(N,) whether points (N, 2) are inside the convex hull of an outline (M, 2)."""
    hull = cv2.convexHull(outline.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    along = np.roll(hull, -1, axis=0) - hull
    to = xy[:, None] - hull[None]
    side = along[None, :, 0] * to[:, :, 1] - along[None, :, 1] * to[:, :, 0]
    return np.asarray((side >= 0).all(axis=1) | (side <= 0).all(axis=1))


def _area(outline: Floats) -> float:
    return float(cv2.contourArea(outline.astype(np.float32)))
