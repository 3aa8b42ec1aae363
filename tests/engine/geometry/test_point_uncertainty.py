"""The predicted standard deviation of points is that of points refined on noisy pixels."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.projection import Intrinsics, PixelObservations
from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats
from vo.engine.geometry.point_uncertainty import position_sigma
from vo.engine.geometry.points import best_points, point_views

FOCAL, BASELINE, SIGMA_PX, SIGMA_DISPARITY = 500.0, 0.2, 0.5, 0.3


@pytest.mark.parametrize("stereo", [True, False])
def test_standard_deviation_is_that_of_many_noisy_trials(stereo: bool) -> None:
    rng = np.random.default_rng(0)
    true, trials = np.array([0.5, -0.3, 6.0]), 2000
    centres = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.0], [0.8, 0.0, 0.3]])
    cam_from_world = np.stack([make_transform(np.eye(3), -c) for c in centres])
    in_cam = true - centres
    xy = FOCAL * in_cam[:, :2] / in_cam[:, 2:] + rng.normal(0, SIGMA_PX, (trials, 3, 2))
    disparity = np.full((trials, 3), np.nan)
    if stereo:
        noise = rng.normal(0, SIGMA_DISPARITY, (trials, 3))
        disparity = FOCAL * BASELINE / in_cam[:, 2] + noise
    focal_baseline = FOCAL * BASELINE if stereo else 0.0
    point, camera = np.repeat(np.arange(trials), 3), np.tile(np.arange(3), trials)
    observed = PixelObservations(
        xy.reshape(-1, 2), disparity.ravel(), np.full(3 * trials, SIGMA_PX), SIGMA_DISPARITY
    )
    views = point_views(
        np.ones(trials, dtype=bool),
        point,
        camera,
        observed,
        Intrinsics(FOCAL, FOCAL, 0.0, 0.0),
        focal_baseline,
        huber=1e9,
    )
    found, _ = best_points(np.tile(true, (trials, 1)), cam_from_world, views, tolerance=1e-6)
    measured = np.sqrt(((found - true) ** 2).sum(axis=1).mean())
    predicted = position_sigma(
        np.tile(true, (trials, 1)),
        centres,
        point,
        camera,
        observed.disparity,
        observed.sigma_px,
        FOCAL,
        focal_baseline / SIGMA_DISPARITY,
    )
    assert predicted == pytest.approx(measured, rel=0.1)


def test_one_ray_determines_no_depth() -> None:
    one = np.zeros(1, dtype=np.int64)
    unknown, known, sigma_px = np.array([np.nan]), np.ones(1), np.ones(1)
    arguments = (np.ones((1, 3)), np.zeros((1, 3)), one, one)
    assert np.isinf(position_sigma(*arguments, unknown, sigma_px, FOCAL, 0.0)).all()
    assert np.isfinite(position_sigma(*arguments, known, sigma_px, FOCAL, 50.0)).all()


def test_observations_of_other_points_do_not_count() -> None:
    point, camera = np.array([0, -1, 0]), np.array([0, 1, 1])
    centres, disparity = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([3.0, 9.0, 2.0])

    def sigma(used: list[int]) -> Floats:
        observed = point[used], camera[used], disparity[used], np.ones(len(used))
        at = np.array([[0.0, 0.0, 5.0]])
        return position_sigma(at, centres, *observed, FOCAL, 50.0)

    assert sigma([0, 1, 2]) == sigma([0, 2]) < sigma([0])
