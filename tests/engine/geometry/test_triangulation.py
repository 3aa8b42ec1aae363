from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import make_transform, se3_exp, transform_points
from vo.base.types import Floats
from vo.engine.geometry.triangulation import in_front, triangulate, triangulate_pixels

SECOND_FROM_FIRST = se3_exp(np.array([0.05, -0.1, 0.02, -0.8, 0.1, 0.3]))


def _points(count: int = 100) -> Floats:
    rng = np.random.default_rng(0)
    return rng.uniform((-4, -3, 3), (4, 3, 25), (count, 3))


def _rays(points: Floats) -> Floats:
    return np.asarray(points[:, :2] / points[:, 2:])


def test_points_are_exact_without_noise() -> None:
    points = _points()
    moved = transform_points(SECOND_FROM_FIRST, points)
    found, _ = triangulate(SECOND_FROM_FIRST, _rays(points), _rays(moved))
    np.testing.assert_allclose(found, points, rtol=1e-9, atol=1e-9)
    assert in_front(found, SECOND_FROM_FIRST).all()


def test_angles_are_those_between_the_rays() -> None:
    second_from_first = make_transform(np.eye(3), np.array([-2.0, 0.0, 0.0]))
    points = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, np.sqrt(3.0)], [1.0, 0.0, 1e6]])
    moved = transform_points(second_from_first, points)
    _, angle = triangulate(second_from_first, _rays(points), _rays(moved))
    np.testing.assert_allclose(np.rad2deg(angle), [90.0, 60.0, np.rad2deg(2e-6)], rtol=1e-6)


def test_noise_moves_points_as_predicted() -> None:
    rng = np.random.default_rng(1)
    points = _points(500)
    moved = transform_points(SECOND_FROM_FIRST, points)
    noise = 0.5 / 500  # half a pixel at a focal length of 500
    rays = _rays(points) + rng.normal(0, noise, (500, 2))
    found, angle = triangulate(
        SECOND_FROM_FIRST, rays, _rays(moved) + rng.normal(0, noise, (500, 2))
    )
    expected = np.sqrt(2.0) * noise * np.linalg.norm(points, axis=1) / angle
    error = np.linalg.norm(found - points, axis=1)
    sure = angle > np.deg2rad(2.0)
    assert 0.3 < np.median(error[sure] / expected[sure]) < 1.5


def test_parallel_rays_give_no_finite_point() -> None:
    rays = np.array([[0.0, 0.0], [0.3, -0.2], [1.0, 1.0]])
    sideways = make_transform(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    found, angle = triangulate(sideways, rays, rays)
    np.testing.assert_allclose(angle, 0.0, atol=1e-12)
    far = ~np.isfinite(found).all(axis=1) | (np.linalg.norm(found, axis=1) > 1e6)
    assert far.all()
    assert not in_front(found[~np.isfinite(found).all(axis=1)], sideways).any()


def test_without_translation_there_is_no_parallax() -> None:
    turn = se3_exp(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    points = _points()
    _, angle = triangulate(turn, _rays(points), _rays(transform_points(turn, points)))
    np.testing.assert_allclose(angle, 0.0, atol=1e-7)


def test_diverging_rays_meet_behind_the_cameras() -> None:
    sideways = make_transform(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    found, _ = triangulate(sideways, np.array([[-0.1, 0.0]]), np.array([[0.1, 0.0]]))
    np.testing.assert_allclose(found, [[0.5, 0.0, -5.0]], atol=1e-9)
    assert not in_front(found, sideways).any()


def test_in_front_means_of_both_cameras() -> None:
    ahead = make_transform(np.eye(3), np.array([0.0, 0.0, -2.0]))  # the second is 2 m ahead
    points = np.array([[0.0, 0, 3], [0, 0, 1], [0, 0, -1], [0, 0, 2], [np.inf] * 3, [np.nan] * 3])
    assert in_front(points, ahead).tolist() == [True, False, False, False, False, False]


@pytest.mark.parametrize("count", [0, 1])
def test_few_points_keep_their_shapes(count: int) -> None:
    points = _points(count)
    moved = transform_points(SECOND_FROM_FIRST, points)
    found, angle = triangulate(SECOND_FROM_FIRST, _rays(points), _rays(moved))
    assert found.shape == (count, 3) and angle.shape == (count,)


INTRINSICS = Intrinsics(500.0, 480.0, 320.0, 200.0)


def _pixels(points: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = INTRINSICS
    return np.asarray(_rays(points) * (fx, fy) + (cx, cy))


def _triangulated(
    second: np.ndarray, points: np.ndarray, **limits: float
) -> tuple[Floats, list[bool]]:
    found = triangulate_pixels(
        second,
        _pixels(points),
        _pixels(transform_points(second, points)),
        INTRINSICS,
        **{"min_parallax_rad": 0.01, "min_parallax_ratio": 0.0, "max_error_px": 1.75, **limits},
    )
    return found.xyz, found.valid.tolist()


def test_points_with_sufficient_parallax_are_valid_and_exact() -> None:
    points = np.array([[0.3, -0.2, 4.0], [1.0, 0.5, 12.0], [-0.4, 0.1, 400.0]])
    sideways = se3_exp(np.array([0.0, 0.0, 0.0, -0.3, 0.0, 0.0]))
    found, valid = _triangulated(sideways, points)
    assert valid == [True, True, False]  # 0.3 m in 400 m are less than 0.01 rad
    np.testing.assert_allclose(found[:2], points[:2], rtol=1e-9)


def test_minimum_parallax_grows_with_the_motion_in_the_image() -> None:
    turn = se3_exp(np.array([0.0, 0.2, 0.0, -0.1, 0.0, 0.0]))  # 0.2 rad, of which 0.025 parallax
    points = np.array([[0.3, -0.2, 4.0]])
    assert _triangulated(turn, points, min_parallax_ratio=0.05)[1] == [True]
    assert _triangulated(turn, points, min_parallax_ratio=0.3)[1] == [False]


def test_points_behind_a_camera_are_invalid() -> None:
    ahead = se3_exp(np.array([0.0, 0.0, 0.0, -0.2, 0.0, -5.0]))  # 5 m ahead
    points = np.array([[0.5, 0.2, 4.0], [0.5, 0.2, 9.0]])
    assert _triangulated(ahead, points)[1] == [False, True]


def test_points_with_large_reprojection_errors_are_invalid() -> None:
    sideways = se3_exp(np.array([0.0, 0.0, 0.0, -0.3, 0.0, 0.0]))
    first = _pixels(np.array([[0.3, -0.2, 4.0]]))
    second = _pixels(transform_points(sideways, np.array([[0.3, -0.2, 4.0]])))
    for off_px, expected in ((1.0, True), (8.0, False)):
        found = triangulate_pixels(
            sideways,
            first,
            second + (0.0, off_px),
            INTRINSICS,
            min_parallax_rad=0.01,
            min_parallax_ratio=0.0,
            max_error_px=1.75,
        )
        assert found.valid.tolist() == [expected]
