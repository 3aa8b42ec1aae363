"""Residuals of the motions by images and by the sensor, and their normal equations."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from inertial_flight import (
    ACCEL_BIAS,
    GYRO_BIAS,
    IMU_FROM_CAM,
    NOISE,
    START_NS,
    keyframe_stamps,
    path,
    sensor,
    world_from_cam,
)

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.geometry import so3
from vo.engine.inertial.chain_solver import empty_equations
from vo.engine.inertial.factor_kernels import add_factors
from vo.engine.inertial.factors import (
    Linearised,
    Motions,
    as_arrays,
    inertial_residuals,
    visual_residuals,
)
from vo.engine.inertial.preintegration import preintegrate
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import LOG_SCALE, WIDTH, States

Residuals = Callable[[States, States], Linearised]

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


def _check_derivatives(residuals: Residuals, before: States, after: States) -> None:
    found = residuals(before, after)
    for column in range(WIDTH):
        step = np.zeros((_COUNT, WIDTH))
        step[:, column] = 1e-6
        for derivative, ends in (
            (found.first, [(before.moved(sign * step), after) for sign in (1.0, -1.0)]),
            (found.second, [(before, after.moved(sign * step)) for sign in (1.0, -1.0)]),
        ):
            more, less = (residuals(*pair) for pair in ends)
            expected = (more.residual - less.residual) / 2e-6
            np.testing.assert_allclose(derivative[:, :, column], expected, atol=1e-6)


def test_derivatives_are_those_of_the_residuals() -> None:
    before, after, motions = _states()
    rng = np.random.default_rng(1)
    motions = _disturbed(motions, 0.05 * rng.standard_normal((_COUNT, 6)))
    _check_derivatives(lambda *ends: visual_residuals(*ends, motions, IMU_FROM_CAM), before, after)


def _inertial() -> Motions:
    """Motions by the samples between the states, at biases that are slightly wrong."""
    reader, stamps = SampleReader(sensor()), keyframe_stamps(_COUNT + 1).tolist()
    measured = []
    for first, last in pairwise(stamps):
        interval = reader.between(first, last)
        assert interval is not None
        measured.append(preintegrate(interval, GYRO_BIAS + 1e-3, ACCEL_BIAS - 0.01, NOISE))
    return as_arrays(measured)


def test_inertial_residuals_of_true_states_are_zero() -> None:
    before, after, _ = _states()
    before = before._replace(
        gyro_bias=np.tile(GYRO_BIAS, (_COUNT, 1)), accel_bias=np.tile(ACCEL_BIAS, (_COUNT, 1))
    )
    found = inertial_residuals(before, after, _inertial())
    assert found.residual == pytest.approx(0.0, abs=1e-3)  # samples are 5 ms apart
    wrong = before._replace(velocity=before.velocity + 0.1)
    assert np.abs(inertial_residuals(wrong, after, _inertial()).residual).max() > 0.05


def test_inertial_derivatives_are_those_of_the_residuals() -> None:
    before, after, _ = _states()
    rng = np.random.default_rng(3)
    before = before.moved(0.05 * rng.standard_normal((_COUNT, WIDTH)))
    motions = _inertial()
    _check_derivatives(lambda *ends: inertial_residuals(*ends, motions), before, after)


@pytest.mark.parametrize("angle", [1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-4, np.pi])
def test_rotations_of_any_angle_have_a_residual(angle: float) -> None:
    before, after, motions = _states()
    rng = np.random.default_rng(4)
    axis = rng.standard_normal((_COUNT, 3))
    vector = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    turned = _disturbed(motions, np.concatenate([-vector, np.zeros_like(vector)], axis=1))
    found = visual_residuals(before, after, turned, IMU_FROM_CAM).residual[:, :3]
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), angle, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(so3.exp(found), so3.exp(vector), atol=1e-7)


@pytest.mark.parametrize("huber", [np.inf, 2.0])
def test_equations_are_those_of_weighted_least_squares(huber: float) -> None:
    rng = np.random.default_rng(5)
    residual, rows = rng.standard_normal((3, 6)), np.array([0, 2, 3])
    residual[1] *= 9.0  # an outlier
    first, second = rng.standard_normal((2, 3, 6, WIDTH))
    root = rng.standard_normal((3, 6, 6))
    information = root @ np.swapaxes(root, 1, 2)
    equations = empty_equations(5, WIDTH)
    total = add_factors(rows, residual, first, second, information, huber, equations)
    squared = np.einsum("ni,nij,nj->n", residual, information, residual)
    assert total == pytest.approx(squared.sum())
    hessian, gradient = np.zeros((5 * WIDTH, 5 * WIDTH)), np.zeros(5 * WIDTH)
    for k, row in enumerate(rows.tolist()):
        jacobian = np.zeros((6, 5 * WIDTH))
        jacobian[:, row * WIDTH : (row + 1) * WIDTH] = first[k]
        jacobian[:, (row + 1) * WIDTH : (row + 2) * WIDTH] = second[k]
        weight = min(1.0, huber / np.sqrt(squared[k] / 6))
        hessian += weight * jacobian.T @ information[k] @ jacobian
        gradient += weight * jacobian.T @ information[k] @ residual[k]
    found = np.zeros((5, WIDTH, 5, WIDTH))
    for row in range(5):
        found[row, :, row] = equations.before[row] + equations.after[row]
        if row < 4:
            found[row, :, row + 1] = equations.coupling[row]
            found[row + 1, :, row] = equations.coupling[row].T
    np.testing.assert_allclose(found.reshape(5 * WIDTH, -1), hessian, atol=1e-9)
    gradients = equations.gradient_before + equations.gradient_after
    np.testing.assert_allclose(gradients.ravel(), gradient, atol=1e-9)


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
