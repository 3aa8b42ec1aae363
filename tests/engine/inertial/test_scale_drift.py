"""Covariances of the motions of one camera, with the common error of their scale and without it."""

from __future__ import annotations

import numpy as np
import pytest
from inertial_flight import IMU_FROM_CAM, keyframe_stamps, world_from_cam

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.inertial.scale_drift import without_scale
from vo.engine.inertial.states import Steps

_TURN, _MOVE = 1e-3, 3e-3
_OWN = np.diag([_TURN**2] * 3 + [_MOVE**2] * 3)
_COUNT = 12


def _steps(sigma: Floats, breaks: tuple[int, ...] = ()) -> Steps:
    """Motions whose scale has these standard deviations (n,) beside their own errors."""
    poses = world_from_cam(keyframe_stamps(_COUNT + 1))
    motions = inverse(poses[:-1]) @ poses[1:]
    along = np.zeros((_COUNT, 6))
    along[:, 3:] = np.einsum("nji,nj->ni", motions[:, :3, :3], motions[:, :3, 3])
    covariance = _OWN + (sigma**2)[:, None, None] * along[:, :, None] * along[:, None, :]
    is_visual = np.ones(_COUNT, dtype=bool)
    is_visual[list(breaks)] = False
    covariance[~is_visual] = 0.0
    return Steps(
        np.full(_COUNT, 0.5),
        (None,) * _COUNT,
        motions,
        covariance,
        is_visual,
        False,
        IMU_FROM_CAM,
    )


@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.1])
def test_common_error_of_the_scale_is_taken_out(sigma: float) -> None:
    steps = _steps(np.full(_COUNT, sigma))
    found = without_scale(steps)
    length = np.linalg.norm(steps.visual[:, :3, 3], axis=1)
    left = 1e-3 * (sigma * length) ** 2  # what is kept of it
    for k in range(_COUNT):
        assert np.abs(found[k] - _OWN).max() <= left[k] + 1e-12


def test_one_motion_that_seems_certain_leaves_no_error_in_the_others() -> None:
    sigma = np.full(_COUNT, 0.02)
    sigma[8] = 0.002
    assert np.abs(without_scale(_steps(sigma)) - _OWN).max() < 1e-6


def test_own_errors_in_all_directions_stay() -> None:
    steps = _steps(np.full(_COUNT, 0.02))
    steps.covariance[3:6, 3:, 3:] += 0.05**2 * np.eye(3)
    assert without_scale(steps)[4, 3, 3] > 0.05**2


def test_an_error_that_few_motions_have_stays() -> None:
    sigma = np.full(_COUNT, 0.02)
    sigma[3:6] = 0.1
    steps = _steps(sigma)
    along = np.linalg.eigvalsh(without_scale(steps)[4, 3:, 3:])[-1]
    assert along > 0.5 * (0.1 * np.linalg.norm(steps.visual[4, :3, 3])) ** 2


def test_segments_have_scales_of_their_own() -> None:
    sigma = np.where(np.arange(_COUNT) < 6, 0.1, 0.02)
    found = without_scale(_steps(sigma, breaks=(6,)))
    assert np.isfinite(found).all()
    assert np.abs(found[:6] - _OWN).max() < 1e-3 * 0.1**2
