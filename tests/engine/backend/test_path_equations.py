"""Normal equations of long paths, in levels of poses that see the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Floats
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.loop_adjustment import (
    NO_MOTIONS,
    adjust_path,
    path_covariance,
    path_information,
)
from vo.engine.backend.path_equations import coupled_poses, levels_of
from vo.engine.backend.solution import information_by_images
from vo.engine.backend.window_problem import WindowProblem

_CAMERA, _BASELINE_M, _SIGMA_PX, _SIGMA_D = Intrinsics(400.0, 400.0, 320.0, 240.0), 0.12, 0.1, 0.15
_CONFIG = load_config("best").smoothing


def _walk(count: int) -> tuple[Floats, WindowProblem]:
    """Poses on a bent path, and what they see of landmarks ahead, from a start that drifts."""
    random = np.random.default_rng(3)
    step = se3_exp(np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.25]))
    drift = se3_exp(np.array([1e-5, 4e-5, 2e-5, 0.0, 0.0, 2e-3]))
    truth, start = np.tile(np.eye(4), (2, count, 1, 1))
    for k in range(1, count):
        truth[k], start[k] = truth[k - 1] @ step, start[k - 1] @ step @ drift
    parts, points = [], []
    for k in range(count):
        depth = random.uniform(4.0, 9.0, 30)
        xy = random.uniform((0, 0), (640, 480), (30, 2))
        rays = np.column_stack([(xy - (320.0, 240.0)) / 400.0, np.ones(30)])
        world = (depth[:, None] * rays) @ truth[k, :3, :3].T + truth[k, :3, 3]
        points.append((depth[:, None] * rays) @ start[k, :3, :3].T + start[k, :3, 3])
        for j in range(max(0, k - 8), k + 1):
            at = (world - truth[j, :3, 3]) @ truth[j, :3, :3]
            pixel = 400.0 * at[:, :2] / at[:, 2:] + (320.0, 240.0)
            rows = np.flatnonzero((pixel > 0.0).all(axis=1) & (pixel < (640.0, 480.0)).all(axis=1))
            disparity = 400.0 * _BASELINE_M / at[rows, 2]
            parts.append((np.full(len(rows), j), 30 * k + rows, pixel[rows], disparity))
    keyframe, point, xy, disparity = (np.concatenate(each) for each in zip(*parts, strict=True))
    xy = xy + random.normal(0.0, _SIGMA_PX, xy.shape)
    disparity = disparity + random.normal(0.0, _SIGMA_D, len(disparity))
    order = np.argsort(keyframe, kind="stable")
    problem = WindowProblem(
        _CAMERA,
        _BASELINE_M,
        _SIGMA_D,
        start,
        np.arange(count) == 0,
        np.concatenate(points),
        keyframe,
        point,
        xy,
        disparity,
        np.full(len(xy), _SIGMA_PX),
    )
    return truth, problem.select(order)


def _error(truth: Floats, poses: Floats) -> float:
    return float(np.linalg.norm(truth[:, :3, 3] - poses[:, :3, 3], axis=1).max())


@pytest.mark.parametrize("seed", range(4))
def test_levels_couple_only_with_their_neighbours(seed: int) -> None:
    """Of sparse random graphs, which need not be connected."""
    random = np.random.default_rng(seed)
    count = 40
    coupled = random.random((count, count)) < 0.04
    coupled |= coupled.T
    levels = levels_of(coupled)
    assert levels.order[0] == 0
    np.testing.assert_array_equal(np.sort(levels.order), np.arange(count))
    level = np.searchsorted(levels.begins, levels.place, side="right")
    a, b = np.nonzero(coupled[1:, 1:])
    assert np.abs(level[1:][a] - level[1:][b]).max() <= 1
    low, high = np.sort(levels.place[np.stack(np.nonzero(coupled))], axis=0)
    assert (high < levels.end[low]).all()
    # Each block on and above the diagonal has a place of its own.
    number = [levels.row[a] + b for a in range(count) for b in range(a, levels.end[a])]
    assert len(set(number)) == len(number)


def test_poses_with_a_common_landmark_are_coupled() -> None:
    point, keyframe = np.array([0, 0, 1, 1, 2, 2]), np.array([0, 2, 1, 3, 0, 3])
    coupled = coupled_poses(np.array([True, True, False]), point, keyframe, 4)
    expected = np.eye(4, dtype=bool)
    expected[[0, 2, 1, 3], [2, 0, 3, 1]] = True
    np.testing.assert_array_equal(coupled, expected)


def test_steps_are_those_of_dense_normal_equations() -> None:
    _, problem = _walk(60)
    usable = np.ones(len(problem.points), bool)
    coupled = coupled_poses(usable, problem.point, problem.keyframe, 60)
    coupled[2, 50] = coupled[50, 2] = True  # a loop
    levels = levels_of(coupled)
    problem = replace(
        problem,
        world_from_cam=problem.world_from_cam[levels.order],
        keyframe=levels.place[problem.keyframe],
    )
    bundle = Bundle(problem, usable, _CONFIG)
    equations, gradient = bundle.path_equations(problem.world_from_cam, levels)
    dense = bundle.normal_equations(problem.world_from_cam)
    np.testing.assert_allclose(gradient[6:], dense.gradient, atol=1e-9 * np.abs(gradient).max())
    block, (a, b) = np.diag(np.arange(1e3, 7e3, 1e3)), np.sort(levels.place[[2, 50]])
    equations.add(a, b, block)
    hessian, at = dense.hessian.copy(), np.arange(6)
    for row, column, part in ((a, b, block), (b, a, block.T)):
        hessian[np.ix_(6 * row - 6 + at, 6 * column - 6 + at)] += part
    for damping in (0.0, 1e-3):
        damped = hessian + damping * np.diag(np.diag(hessian))
        expected = np.linalg.solve(damped, gradient[6:])
        found = equations.solve(gradient[6:, None], damping)[:, 0]
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_covariances_are_those_of_the_dense_inverse() -> None:
    _, problem = _walk(50)
    path = adjust_path(problem, NO_MOTIONS, _CONFIG)
    assert path is not None
    equations = path_information(problem, path, NO_MOTIONS, _CONFIG)
    found = path_covariance(equations)
    assert equations is not None and found is not None
    usable = np.bincount(problem.point, minlength=len(problem.points)) >= 2
    information = information_by_images(problem, *path, usable, _CONFIG)[6:, 6:]
    dense = equations.dense()
    np.testing.assert_allclose(2.0 * dense, information, atol=1e-9 * np.abs(dense).max())
    blocks = 2.0 * np.linalg.inv(information).reshape(49, 6, 49, 6)  # errors are alike
    np.testing.assert_array_equal(found[0], 0.0)
    expected = blocks[np.arange(49), :, np.arange(49)]
    scale = np.sqrt(np.einsum("kii->ki", expected))
    off = (found[1:] - expected) / (scale[:, :, None] * scale[:, None])
    assert np.abs(off).max() < 1e-6


def test_the_drift_of_a_long_path_is_removed() -> None:
    """By a matrix with a twentieth of the blocks of a dense one, and little damping."""
    truth, problem = _walk(300)
    usable = np.ones(len(problem.points), bool)
    levels = levels_of(coupled_poses(usable, problem.point, problem.keyframe, 300))
    assert levels.row[299] + 299 < 300 * 300 / 20
    path = adjust_path(problem, NO_MOTIONS, _CONFIG)
    assert path is not None
    np.testing.assert_array_equal(path.world_from_cam[0], truth[0])
    assert _error(truth, path.world_from_cam) < 0.05 * _error(truth, problem.world_from_cam)
