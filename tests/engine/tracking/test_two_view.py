"""Motion and points from two views, or why there are none."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.config import StartConfig
from vo.base.failures import Failure, FailureReason, describe
from vo.base.geometry.transforms import rotation_angle, se3_exp, se3_log, transform_points
from vo.base.types import Floats
from vo.engine.tracking.essential_matrix import scale_from_points
from vo.engine.tracking.two_view import IntermediateView, MatchedViews, TwoView, _try, reconstruct

MATRIX = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 240.0], [0.0, 0.0, 1.0]])
CONFIG = StartConfig()
AMBIGUOUS = Failure(FailureReason.AMBIGUOUS_PLANE)
SIDEWAYS = se3_exp(np.array([0.02, -0.05, 0.01, -0.6, 0.1, 0.05]))
OVER = se3_exp(np.array([0.01, -0.02, 0.01, -0.1, 1.2, -1.5]))  # fields that lie ahead and below
FORWARD = se3_exp(np.array([0.01, -0.02, 0.0, 0.05, -0.02, -1.0]))


def _project(points: Floats) -> Floats:
    pixels = points @ MATRIX.T
    return np.asarray(pixels[:, :2] / pixels[:, 2:])


def _rays(count: int, seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    flat = rng.uniform((-0.44, -0.33), (0.44, 0.33), (count, 2))
    return np.hstack([flat, np.ones((count, 1))])


def _room(count: int = 400, seed: int = 0) -> Floats:
    depth = np.random.default_rng(seed + 100).uniform(3.0, 12.0, (count, 1))
    return np.asarray(_rays(count, seed) * depth)


def _wall(count: int = 400, seed: int = 0) -> Floats:
    normal = np.array([0.3, -0.2, 1.0])
    rays = _rays(count, seed)
    return np.asarray(rays * (6.0 / (rays @ normal))[:, None])


def _reconstruct(
    points: Floats,
    motion: Floats,
    *,
    noise: float = 0.2,
    outliers: float = 0.0,
    seed: int = 0,
) -> TwoView | Failure:
    rng = np.random.default_rng(seed)
    first, second = _project(points), _project(transform_points(motion, points))
    first = first + noise * rng.standard_normal(first.shape)
    second = second + noise * rng.standard_normal(second.shape)
    wrong = int(outliers * len(points))
    second[:wrong] = rng.uniform((0, 0), (640, 480), (wrong, 2))
    return reconstruct(MatchedViews(first, second, MATRIX), CONFIG)


def _errors_deg(found: TwoView, motion: Floats) -> tuple[float, float]:
    turn = rotation_angle(found.second_from_first[:3, :3].T @ motion[:3, :3])
    a, b = found.second_from_first[:3, 3], motion[:3, 3]
    direction = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    return float(np.rad2deg(turn)), float(np.rad2deg(direction))


@pytest.mark.parametrize("motion", [SIDEWAYS, FORWARD], ids=["sideways", "forward"])
@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_a_scene_with_depth_is_reconstructed_by_the_essential_matrix(
    motion: Floats, outliers: float
) -> None:
    points = _room()
    found = _reconstruct(points, motion, outliers=outliers)
    assert isinstance(found, TwoView), found
    assert found.model == "essential"
    turn, direction = _errors_deg(found, motion)
    assert turn < 0.1
    assert direction < 0.5
    assert np.linalg.norm(found.second_from_first[:3, 3]) == pytest.approx(1.0)
    wrong = int(outliers * len(points))
    assert found.good[:wrong].mean() < 0.2 if wrong else True
    assert found.good[wrong:].mean() > 0.6


def test_points_are_right_up_to_scale_without_noise() -> None:
    points = _room()
    found = _reconstruct(points, SIDEWAYS, noise=0.0)
    assert isinstance(found, TwoView), found
    scaled = found.points * np.linalg.norm(SIDEWAYS[:3, 3])
    np.testing.assert_allclose(scaled[found.good], points[found.good], rtol=1e-3, atol=1e-3)


def test_good_points_lie_close_to_the_truth_with_noise() -> None:
    points = _room()
    found = _reconstruct(points, SIDEWAYS, outliers=0.2)
    assert isinstance(found, TwoView), found
    scaled = found.points * np.linalg.norm(SIDEWAYS[:3, 3])
    good = np.flatnonzero(found.good & (np.arange(len(points)) >= 80))
    error = np.linalg.norm(scaled[good] - points[good], axis=1) / points[good, 2]
    assert np.median(error) < 0.02


def test_a_plane_is_reconstructed_by_the_homography_or_fails_where_two_motions_fit() -> None:
    results = [_reconstruct(_wall(seed=s), SIDEWAYS, outliers=0.1, seed=s) for s in range(20)]
    found = [r for r in results if isinstance(r, TwoView)]
    assert len(found) >= 12
    assert {f.model for f in found} == {"homography"}
    for turn, direction in (_errors_deg(f, SIDEWAYS) for f in found):
        assert turn < 0.2
        assert direction < 1.0


def _over_fields(
    share: float, *, noise: float, seed: int, frames: int
) -> tuple[TwoView | Failure, Floats]:
    """A part of the flight `OVER`, with views between that each miss a third of the points."""
    rng = np.random.default_rng(seed)
    rays = _rays(400, seed)
    points = rays * (6.0 / (rays @ (0.0, 0.6, 0.8)))[:, None]
    course = share * se3_log(OVER)

    def seen(part: float) -> Floats:
        exact = _project(transform_points(se3_exp(part * course), points))
        return np.asarray(exact + noise * rng.standard_normal(exact.shape))

    first, second, between = seen(0.0), seen(1.0), []
    for part in np.arange(1, frames + 1) / (frames + 1):
        rows = np.flatnonzero(rng.random(400) < 2 / 3)
        between.append(IntermediateView(rows, seen(part)[rows]))
    views = MatchedViews(first, second, MATRIX, between)
    return reconstruct(views, CONFIG), se3_exp(course)


@pytest.mark.parametrize("seed", range(20))
def test_intermediate_views_tell_which_of_a_planes_two_motions_is_true(seed: int) -> None:
    alone, _ = _over_fields(1.0, noise=0.2, seed=seed, frames=0)
    assert alone == AMBIGUOUS
    found, motion = _over_fields(1.0, noise=0.2, seed=seed, frames=4)
    assert isinstance(found, TwoView), found
    assert found.model == "homography"
    turn, direction = _errors_deg(found, motion)
    assert turn < 0.1
    assert direction < 1.0


@pytest.mark.parametrize("seed", range(20))
def test_intermediate_views_decide_nothing_that_could_be_noise(seed: int) -> None:
    found, _ = _over_fields(0.2, noise=0.4, seed=seed, frames=4)
    assert found == AMBIGUOUS


@pytest.mark.parametrize(("seed", "walls", "noise"), [(14, 45, 0.2), (30, 80, 0.2), (30, 80, 0.5)])
def test_a_motion_that_points_off_the_floor_refute_makes_no_map(
    seed: int, walls: int, noise: float
) -> None:
    """A turn with a few centimetres of travel, mostly over a floor: two motions fit the floor."""
    rng = np.random.default_rng(seed)
    ahead = rng.uniform(1.6, 7.0, 220)
    floor = np.stack([rng.uniform(-1.1, 1.1, 220), np.full(220, 1.4), ahead], axis=1)
    ahead = rng.uniform(2.0, 8.0, walls)
    sides = [rng.choice([-1.2, 1.2], walls), rng.uniform(-1.0, 1.3, walls), ahead]
    points, matrix = np.concatenate([floor, np.stack(sides, axis=1)]), np.diag([320.0, 320.0, 1.0])
    step, turn = rng.normal(size=3), rng.normal(size=3)
    course = np.r_[0.06 * turn / np.linalg.norm(turn), -0.06 * step / np.linalg.norm(step)]
    if noise == 0.5:
        course[3:] *= 0.5

    def seen(part: float) -> Floats:
        in_camera = transform_points(se3_exp(part * course), points)
        exact = 320.0 * in_camera[:, :2] / in_camera[:, 2:]
        return np.asarray(exact + rng.normal(0.0, noise, exact.shape))

    between = [IntermediateView(np.arange(len(points)), seen(part)) for part in (1 / 3, 2 / 3)]
    second, first = seen(1.0), seen(0.0)
    assert reconstruct(MatchedViews(first, second, matrix, between), CONFIG) == AMBIGUOUS


@pytest.mark.parametrize("seed", range(50))
def test_pure_rotation_never_makes_a_map(seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    turn = 0.15 * axis / np.linalg.norm(axis)
    points = _room(seed=seed)
    outliers = 0.1 if seed % 2 else 0.0
    assert isinstance(
        _reconstruct(points, se3_exp(np.r_[turn, 0, 0, 0]), outliers=outliers, seed=seed),
        Failure,
    )


@pytest.mark.parametrize("seed", range(20))
def test_standing_still_never_makes_a_map(seed: int) -> None:
    result = _reconstruct(_room(seed=seed), np.eye(4), noise=0.5, seed=seed)
    assert result == Failure(FailureReason.LITTLE_MOTION)


@pytest.mark.parametrize("seed", range(20))
def test_standing_still_while_few_things_move_never_makes_a_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = _project(_room(seed=seed))
    second = first + 0.3 * rng.standard_normal(first.shape)
    second[:150] += (25.0, 3.0)
    assert isinstance(reconstruct(MatchedViews(first, second, MATRIX), CONFIG), Failure)


def test_too_little_parallax_is_told_in_degrees() -> None:
    turn_and_step = se3_exp(np.array([0.0, 0.03, 0.0, -0.03, 0.0, 0.0]))
    result = _reconstruct(_room(), turn_and_step, noise=0.05)
    assert isinstance(result, Failure)
    assert "parallax" in describe(result) and "1.0° needed" in describe(result)


def test_too_few_matches_are_told_by_number() -> None:
    few = CONFIG.min_matches - 1
    result = _reconstruct(_room(few), SIDEWAYS)
    assert isinstance(result, Failure)
    assert f"{few} matches" in describe(result)
    assert f"{CONFIG.min_matches} needed" in describe(result)


def test_random_matches_make_no_map() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform((0, 0), (640, 480), (2, 300, 2))
    assert isinstance(reconstruct(MatchedViews(first, second, MATRIX), CONFIG), Failure)


def test_matches_with_parallel_rays_make_no_point_and_no_warning() -> None:
    pixels = _project(_room(20))
    moved = pixels.copy()
    moved[1:] -= [7.0, 0.0]
    motion = se3_exp(np.array([0.0, 0.0, 0.0, -0.1, 0.0, 0.0]))
    views = MatchedViews(pixels, moved, MATRIX)
    _, good, _ = _try(motion, np.ones(20, np.bool_), views, CONFIG)
    assert good.tolist() == [False, *[True] * 19]


def test_a_turning_camera_is_told_as_such() -> None:
    turn = se3_exp(np.array([0.02, -0.15, 0.03, 0.0, 0.0, 0.0]))
    assert _reconstruct(_room(), turn) == Failure(FailureReason.PURE_ROTATION)


def _step(length: float) -> tuple[Floats, Floats, Floats]:
    """A motion of unit length, points before it and their rays after a step of `length`."""
    rng = np.random.default_rng(0)
    unit = se3_exp(np.array([0.02, -0.03, 0.01, 0.0, 0.0, 0.0]))
    unit[:3, 3] = np.array([0.6, -0.1, -0.79]) / np.linalg.norm([0.6, -0.1, -0.79])
    points = rng.uniform((-4, -3, 4), (4, 3, 20), (80, 3))
    motion = unit.copy()
    motion[:3, 3] *= length
    moved = transform_points(motion, points)
    return unit, points, moved[:, :2] / moved[:, 2:]


@pytest.mark.parametrize("length", [0.01, 0.3, 2.5])
def test_the_scale_is_exact_without_noise(length: float) -> None:
    scale, support = scale_from_points(*_step(length))
    assert scale == pytest.approx(length, rel=1e-9)
    assert support == 80


def test_the_scale_survives_outliers_and_noise() -> None:
    unit, points, rays = _step(0.5)
    rng = np.random.default_rng(1)
    rays = rays + rng.normal(0, 0.0005, rays.shape)
    rays[:20] += rng.uniform(-0.3, 0.3, (20, 2))
    scale, support = scale_from_points(unit, points, rays)
    assert scale == pytest.approx(0.5, rel=0.05)
    assert 50 <= support <= 70


def test_points_that_move_the_other_way_support_no_scale() -> None:
    scale, support = scale_from_points(*_step(-0.5))
    assert scale <= 0
    assert support == 0


def test_no_points_support_no_scale() -> None:
    unit, points, rays = _step(0.5)
    assert scale_from_points(unit, points[:0], rays[:0]) == (0.0, 0)


def test_points_in_the_direction_of_motion_say_nothing_of_the_scale() -> None:
    unit = np.eye(4)
    unit[2, 3] = -1.0
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 9.0]])
    assert scale_from_points(unit, points, np.zeros((2, 2))) == (0.0, 0)
