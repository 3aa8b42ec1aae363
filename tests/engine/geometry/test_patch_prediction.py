from __future__ import annotations

import cv2
import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse, make_transform, transform_points
from vo.base.types import Floats
from vo.engine.geometry.neighbours import median_of_nearest
from vo.engine.geometry.patch_prediction import PatchPrediction, points_in_view, predict_patches

FX, FY, CX, CY = INTRINSICS = Intrinsics(400.0, 410.0, 320.0, 240.0)


def _pose(rotvec: tuple[float, float, float], centre: tuple[float, float, float]) -> Floats:
    return make_transform(cv2.Rodrigues(np.array(rotvec))[0], np.array(centre))


def _project(world_from_cam: Floats, points: Floats) -> Floats:
    seen = transform_points(inverse(world_from_cam), points)
    return np.asarray(seen[:, :2] / seen[:, 2:] * (FX, FY) + (CX, CY))


def _predict(
    points: Floats, reference: Floats, target: Floats, normal: Floats | None = None
) -> PatchPrediction:
    """Prediction in the target; without `normal` patches are parallel to the reference image."""
    count = len(points)
    return predict_patches(
        points,
        np.tile(reference[:3, 2] if normal is None else normal, (count, 1)),
        np.zeros(count, np.int64),
        np.arange(count),
        np.ones(count, np.int64),
        np.stack([reference, target]),
        INTRINSICS,
    )


def _points() -> Floats:
    return np.random.default_rng(0).uniform((-2, -2, 4), (2, 2, 9), (50, 3))


def test_scale_is_the_ratio_of_distances() -> None:
    reference = _pose((0.1, -0.2, 0.05), (0.3, 0.1, -0.2))
    target = _pose((-0.05, 0.1, 0.3), (-0.4, 0.2, 0.5))
    points = _points()
    seen = _predict(points, reference, target)
    np.testing.assert_allclose(seen.xy, _project(target, points), atol=1e-9)
    then = np.linalg.norm(points - reference[:3, 3], axis=1)
    now = np.linalg.norm(points - target[:3, 3], axis=1)
    np.testing.assert_allclose(seen.scale, then / now)


def test_points_in_view_are_within_the_bounds_and_the_range_of_scales() -> None:
    reference = _pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    target = _pose((-0.05, 0.1, 0.3), (-0.4, 0.2, 3.0))
    points = np.random.default_rng(1).uniform((-6, -6, -6), (6, 6, 12), (500, 3))
    corners, max_scale = (8.0, 8.0, 632.0, 472.0), 1.5
    found = points_in_view(
        points,
        np.zeros(len(points), np.int64),
        np.stack([reference, target]),
        INTRINSICS,
        max_scale,
        corners,
    )
    seen = _predict(points, reference, target)
    inside = ((seen.xy >= corners[:2]) & (seen.xy < corners[2:])).all(axis=1)
    alike = (seen.scale < max_scale) & (seen.scale > 1.0 / max_scale)
    assert found.rows.tolist() == np.flatnonzero(inside & alike).tolist()
    assert 5 < len(found.rows) < np.count_nonzero(inside)  # so that both conditions matter
    np.testing.assert_array_equal(found.xy, seen.xy[found.rows])
    depth = transform_points(inverse(target), points[found.rows])[:, 2]
    assert (depth > 0).all()


def test_the_warp_of_a_wall_parallel_to_the_reference_image() -> None:
    reference = _pose((0.1, -0.2, 0.05), (0.3, 0.1, -0.2))
    target = _pose((-0.05, 0.3, 0.3), (-0.9, 0.2, 0.5))
    points = _points()
    seen = _predict(points, reference, target)
    depth = transform_points(inverse(reference), points)[:, 2]
    for step in ((1e-3, 0.0), (0.0, 1e-3), (-1e-3, 2e-3)):
        on_wall = np.column_stack([np.tile(step, (len(points), 1)), np.zeros(len(points))])
        moved = points + (on_wall * depth[:, None] / (FX, FY, 1.0)) @ reference[:3, :3].T
        there = _project(target, moved) - _project(target, points)
        back = np.einsum("nij,nj->ni", seen.reference_from_target, there)
        np.testing.assert_allclose(back, np.tile(step, (len(points), 1)), atol=2e-5)


def test_the_warp_of_a_slanted_wall() -> None:
    """Along the wall, exactly to first order, whichever way it is inclined."""
    reference = _pose((0.1, -0.2, 0.05), (0.3, 0.1, -0.2))
    target = _pose((-0.05, 0.3, 0.3), (-0.9, 0.2, 0.5))
    points, normal = _points(), np.array([0.5, -0.4, 1.0])
    seen = _predict(points, reference, target, 2.5 * normal)
    rays = points - reference[:3, 3]
    for step in ((1e-3, 0.0), (0.0, 1e-3), (-1e-3, 2e-3)):
        moved_xy = _project(reference, points) + step
        in_cam = np.column_stack([(moved_xy - (CX, CY)) / (FX, FY), np.ones(len(points))])
        directions = in_cam @ reference[:3, :3].T
        moved = reference[:3, 3] + directions * ((rays @ normal) / (directions @ normal))[:, None]
        there = _project(target, moved) - seen.xy
        back = np.einsum("nij,nj->ni", seen.reference_from_target, there)
        # The finite difference over a pixel is not exact on a slanted wall.
        np.testing.assert_allclose(back, np.tile(step, (len(points), 1)), atol=3e-5)


def test_the_slope_is_that_of_the_wall_in_the_target() -> None:
    reference = _pose((0.1, -0.2, 0.05), (0.3, 0.1, -0.2))
    target = _pose((-0.05, 0.3, 0.3), (-0.9, 0.2, 0.5))
    points, normal = _points(), np.array([0.5, -0.4, 1.0])
    seen = _predict(points, reference, target, normal)
    for axis in range(2):
        inverse_depth = []
        for step in (-1e-3, 1e-3):
            xy = seen.xy + step * np.eye(2)[axis]
            in_cam = np.column_stack([(xy - (CX, CY)) / (FX, FY), np.ones(len(points))])
            ahead = (points - target[:3, 3]) @ normal
            inverse_depth.append(in_cam @ target[:3, :3].T @ normal / ahead)
        change = (inverse_depth[1] - inverse_depth[0]) / 2e-3
        expected = change / np.mean(inverse_depth, axis=0)
        np.testing.assert_allclose(seen.slope[:, axis], expected, atol=1e-9)


def test_points_behind_a_camera_have_no_prediction() -> None:
    behind = _pose((0.0, np.pi, 0.0), (0.0, 0.0, 0.0))
    seen = _predict(_points(), np.eye(4), behind)
    assert np.isnan(seen.xy).all() and (seen.scale == 0.0).all()


def test_patches_seen_edge_on_are_not_warped() -> None:
    aside = _pose((0.0, -np.pi / 2 + 0.01, 0.0), (6.0, 0.0, 6.0))
    seen = _predict(np.array([[0.0, 0.0, 6.0]]), np.eye(4), aside)
    np.testing.assert_array_equal(seen.reference_from_target[0], np.eye(2))


def test_the_median_of_the_three_nearest() -> None:
    rng = np.random.default_rng(1)
    xy, known_xy, known = rng.random((200, 2)), rng.random((40, 2)), rng.random(40)
    distance = np.linalg.norm(xy[:, None] - known_xy[None], axis=2)
    expected = np.median(known[np.argsort(distance, axis=1)[:, :3]], axis=1)
    np.testing.assert_array_equal(median_of_nearest(xy, known_xy, known), expected)


def test_of_equally_distant_points_the_first_count() -> None:
    square = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    values = np.array([5.0, 1.0, 3.0, 100.0])
    assert median_of_nearest(np.zeros((1, 2)), square, values).tolist() == [3.0]
    values = np.array([100.0, 50.0, 1.0, 2.0])
    assert median_of_nearest(np.zeros((1, 2)), square, values).tolist() == [50.0]
