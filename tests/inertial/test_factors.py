"""Residuals of the motions by images."""

from __future__ import annotations

import numpy as np
import pytest
from inertial_flight import IMU_FROM_CAM, START_NS, keyframe_stamps, path, world_from_cam

from vo.geometry import so3
from vo.geometry.transforms import inverse
from vo.inertial.factors import visual_residuals
from vo.inertial.states import LOG_SCALE, WIDTH, States
from vo.types import Floats

_COUNT, _SCALE = 12, 0.5
_TURN, _MOVE = 1e-3, 3e-3  # errors of a motion by images, rad and m


def _states() -> tuple[States, States, Floats]:
    """True states before and after each motion, and the motions in map units."""
    stamps = keyframe_stamps(_COUNT + 1)
    rotation, position, velocity, *_ = path(1e-9 * (stamps - START_NS))
    zeros = np.zeros((_COUNT + 1, 3))
    log_scale = np.full(_COUNT + 1, np.log(_SCALE))
    states = States(rotation, position, velocity, zeros, zeros, log_scale)
    poses = world_from_cam(stamps)
    motions = inverse(poses[:-1]) @ poses[1:]
    motions[:, :3, 3] /= _SCALE
    return states.rows(slice(0, -1)), states.rows(slice(1, None)), motions


def _disturbed(motions: Floats, error: Floats) -> Floats:
    result = motions.copy()
    result[:, :3, :3] = motions[:, :3, :3] @ so3.exp(error[:, :3])
    result[:, :3, 3] += np.einsum("nij,nj->ni", motions[:, :3, :3], error[:, 3:])
    return result


def test_residuals_of_true_states_are_zero() -> None:
    before, after, motions = _states()
    found = visual_residuals(before, after, motions, IMU_FROM_CAM)
    assert found.residual == pytest.approx(0.0, abs=1e-9)


def test_derivatives_are_those_of_the_residuals() -> None:
    before, after, motions = _states()
    rng = np.random.default_rng(1)
    motions = _disturbed(motions, 0.05 * rng.standard_normal((_COUNT, 6)))
    found = visual_residuals(before, after, motions, IMU_FROM_CAM)
    for column in range(WIDTH):
        step = np.zeros((_COUNT, WIDTH))
        step[:, column] = 1e-6
        for derivative, ends in (
            (found.first, [(before.moved(sign * step), after) for sign in (1.0, -1.0)]),
            (found.second, [(before, after.moved(sign * step)) for sign in (1.0, -1.0)]),
        ):
            more, less = (visual_residuals(*pair, motions, IMU_FROM_CAM) for pair in ends)
            expected = (more.residual - less.residual) / 2e-6
            np.testing.assert_allclose(derivative[:, :, column], expected, atol=1e-6)


def test_errors_of_the_motions_do_not_make_the_scale_smaller() -> None:
    before, after, motions = _states()
    rng = np.random.default_rng(2)
    gradients = []
    for _ in range(50):
        error = rng.standard_normal((_COUNT, 6)) * np.repeat([_TURN, _MOVE / _SCALE], 3)
        for sign in (1.0, -1.0):  # in pairs, so that the mean is that of the quadratic terms
            found = visual_residuals(before, after, _disturbed(motions, sign * error), IMU_FROM_CAM)
            off, by_scale = found.residual[:, 3:], found.first[:, 3:, LOG_SCALE]
            gradients.append(float((by_scale * off).sum()) / (_MOVE / _SCALE) ** 2)
    # In metres, with the lengths by images in the derivative, it is 9.
    assert abs(np.mean(gradients)) < 2.0
