"""Preintegration of inertial samples."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from inertial_flight import ACCEL_BIAS, GYRO_BIAS, NOISE, START_NS, path, sensor

from vo.base.types import Floats, ImuNoise
from vo.engine.geometry import so3
from vo.engine.inertial.preintegration import Interval, Preintegrated, preintegrate, rotation_of
from vo.engine.inertial.samples import SampleReader

_GRAVITY = np.array([0.0, 0.0, -9.81])


def _interval(seconds: float = 1.0, rate_hz: int = 200) -> Interval:
    found = SampleReader(sensor(rate_hz=rate_hz)).between(
        START_NS + 2_000_000_000, START_NS + 2_000_000_000 + int(seconds * 1e9)
    )
    assert found is not None
    return found


def _as_vector(before: Preintegrated, after: Preintegrated) -> Floats:
    turned = so3.log(before.rotation.T @ after.rotation)
    moved = (after.velocity - before.velocity, after.position - before.position)
    return np.concatenate([turned, *moved])


def test_motion_is_that_of_the_path() -> None:
    rotation, position, velocity, _, _ = path(np.array([2.0, 3.0]))
    found = preintegrate(_interval(), GYRO_BIAS, ACCEL_BIAS, NOISE)
    start = rotation[0].T
    np.testing.assert_allclose(so3.log((start @ rotation[1]).T @ found.rotation), 0.0, atol=1e-6)
    np.testing.assert_allclose(
        found.velocity, start @ (velocity[1] - velocity[0] - _GRAVITY), atol=2e-5
    )
    np.testing.assert_allclose(
        found.position,
        start @ (position[1] - position[0] - velocity[0] - 0.5 * _GRAVITY),
        atol=1e-5,
    )


def test_constant_rate_and_force_are_integrated_exactly() -> None:
    seconds = np.linspace(0.0, 2.0, 11)
    still = Interval(seconds, np.zeros((11, 3)), np.tile([1.0, 2.0, 3.0], (11, 1)))
    found = preintegrate(still, np.zeros(3), np.zeros(3), NOISE)
    np.testing.assert_allclose(found.velocity, [2.0, 4.0, 6.0], rtol=1e-13)
    np.testing.assert_allclose(found.position, [2.0, 4.0, 6.0], rtol=1e-13)
    turning = Interval(seconds, np.tile([0.0, 0.0, 0.7], (11, 1)), np.zeros((11, 3)))
    found = preintegrate(turning, np.zeros(3), np.zeros(3), NOISE)
    np.testing.assert_allclose(so3.log(found.rotation), [0.0, 0.0, 1.4], atol=1e-13)
    np.testing.assert_allclose(rotation_of(turning, np.zeros(3)), found.rotation, atol=1e-15)


def test_derivatives_by_the_biases_are_exact() -> None:
    interval = _interval()
    found = preintegrate(interval, GYRO_BIAS, ACCEL_BIAS, NOISE)
    for k, step in enumerate(1e-5 * np.eye(6)):
        more = preintegrate(interval, GYRO_BIAS + step[:3], ACCEL_BIAS + step[3:], NOISE)
        less = preintegrate(interval, GYRO_BIAS - step[:3], ACCEL_BIAS - step[3:], NOISE)
        numeric = _as_vector(less, more) / 2e-5
        np.testing.assert_allclose(found.jacobian[:, k], numeric, atol=1e-7)


def test_covariance_is_that_of_gtsam() -> None:
    """GTSAM integrates by Euler's method, so the two agree to a step's length."""
    white = ImuNoise(NOISE.gyro_noise, 0.0, NOISE.accel_noise, 0.0)
    interval = _interval()
    found = preintegrate(interval, GYRO_BIAS, ACCEL_BIAS, white)
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    parameters.setGyroscopeCovariance(np.eye(3) * white.gyro_noise**2)
    parameters.setAccelerometerCovariance(np.eye(3) * white.accel_noise**2)
    parameters.setIntegrationCovariance(np.eye(3) * 1e-14)
    parameters.setBiasAccCovariance(np.eye(3) * 1e-20)
    parameters.setBiasOmegaCovariance(np.eye(3) * 1e-20)
    bias = gtsam.imuBias.ConstantBias(ACCEL_BIAS, GYRO_BIAS)
    other = gtsam.PreintegratedCombinedMeasurements(parameters, bias)
    accel = 0.5 * (interval.accel[1:] + interval.accel[:-1])
    gyro = 0.5 * (interval.gyro[1:] + interval.gyro[:-1])
    for row, dt in enumerate(np.diff(interval.seconds)):
        other.integrateMeasurement(accel[row], gyro[row], dt)
    sigma = np.sqrt(np.diag(found.covariance))
    theirs = np.sqrt(np.diag(other.preintMeasCov())[:9])[[0, 1, 2, 6, 7, 8, 3, 4, 5]]
    np.testing.assert_allclose(sigma, theirs, rtol=0.03)
    np.testing.assert_allclose(other.deltaRij().matrix(), found.rotation, atol=1e-4)
    np.testing.assert_allclose(other.deltaPij(), found.position, atol=0.01)


@pytest.mark.parametrize("rate_hz", [100, 1000])
def test_covariance_does_not_depend_on_the_rate(rate_hz: int) -> None:
    usual = preintegrate(_interval(), GYRO_BIAS, ACCEL_BIAS, NOISE)
    other = preintegrate(_interval(rate_hz=rate_hz), GYRO_BIAS, ACCEL_BIAS, NOISE)
    np.testing.assert_allclose(
        np.diag(other.covariance), np.diag(usual.covariance), rtol=0.05, atol=1e-10
    )


def test_errors_by_noise_have_the_covariance() -> None:
    rng, interval = np.random.default_rng(1), _interval(0.5)
    exact = preintegrate(interval, GYRO_BIAS, ACCEL_BIAS, NOISE)
    errors = []
    for _ in range(300):
        white = np.sqrt(200.0) * rng.standard_normal((2, *interval.gyro.shape))
        noisy = Interval(
            interval.seconds,
            interval.gyro + NOISE.gyro_noise * white[0],
            interval.accel + NOISE.accel_noise * white[1],
        )
        errors.append(_as_vector(exact, preintegrate(noisy, GYRO_BIAS, ACCEL_BIAS, NOISE)))
    squared = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(exact.covariance), errors)
    assert 6.0 < squared.mean() < 9.6  # 9 less what the floor and interpolation take
