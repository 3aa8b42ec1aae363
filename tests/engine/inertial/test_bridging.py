"""Poses between two known ones by the samples in between."""

from __future__ import annotations

import numpy as np
import pytest
from inertial_flight import (
    ACCEL_BIAS,
    GYRO_BIAS,
    IMU_FROM_CAM,
    NOISE,
    START_NS,
    Sensor,
    path,
    sensor,
    world_from_cam,
)

from vo.base.geometry.transforms import inverse, so3_log
from vo.base.types import Floats
from vo.engine.inertial.bridging import Bridge, EndState, bridge, moved_to
from vo.engine.inertial.samples import SampleReader

_FIRST, _LAST = START_NS + 2_000_000_000, START_NS + 3_500_000_000
_BETWEEN = np.arange(_FIRST + 100_000_000, _LAST, 100_000_000)
_SIGMA_M_S, _SIGMA_GYRO, _SIGMA_ACCEL = 0.05, 1e-3, 0.03


def _pose(stamp_ns: int) -> Floats:
    return np.asarray(world_from_cam(np.array([stamp_ns]))[0] @ inverse(IMU_FROM_CAM))


def _end(stamp_ns: int, *, error: float = 0.0, seed: int = 0, is_known: bool = True) -> EndState:
    """The true state, with errors of so many standard deviations."""
    rng = np.random.default_rng(seed)
    velocity = path(np.array([1e-9 * (stamp_ns - START_NS)]))[2][0]
    off = error * rng.standard_normal((3, 3))
    sigma = np.repeat([_SIGMA_M_S, _SIGMA_GYRO, _SIGMA_ACCEL], 3)
    return EndState(
        stamp_ns,
        _pose(stamp_ns),
        velocity + _SIGMA_M_S * off[0] if is_known else None,
        GYRO_BIAS + _SIGMA_GYRO * off[1],
        ACCEL_BIAS + _SIGMA_ACCEL * off[2],
        np.diag(sigma**2),
    )


def _errors(found: Bridge) -> tuple[Floats, Floats]:
    """Errors of rotations, tangent on the right, and of positions, (n, 3) each."""
    true = np.stack([_pose(int(stamp)) for stamp in _BETWEEN])
    turned = np.swapaxes(found.world_from_imu[:, :3, :3], 1, 2) @ true[:, :3, :3]
    return np.stack([so3_log(r) for r in turned]), true[:, :3, 3] - found.world_from_imu[:, :3, 3]


def _bridged(source: Sensor, first: EndState, last: EndState) -> Bridge:
    found = bridge(first, last, _BETWEEN, SampleReader(source), NOISE)
    assert found is not None
    return found


@pytest.mark.parametrize("is_known", [True, False])
def test_exact_samples_give_exact_poses(is_known: bool) -> None:
    found = _bridged(sensor(), _end(_FIRST), _end(_LAST, is_known=is_known))
    turned, moved = _errors(found)
    assert np.abs(turned).max() < 1e-5 and np.abs(moved).max() < 2e-4


def test_a_wrong_velocity_is_corrected_by_the_other_end() -> None:
    first = _end(_FIRST)
    assert first.velocity is not None
    fast = first._replace(velocity=first.velocity + np.array([0.1, 0.0, 0.0]))
    last = _end(_LAST, is_known=False)
    _, moved = _errors(_bridged(sensor(), fast, last))
    assert np.abs(moved).max() < 0.005  # 0.15 m at the other end without it


def test_errors_are_those_that_are_stated() -> None:
    squared = []
    for seed in range(20):
        first, last = _end(_FIRST, error=1.0, seed=seed), _end(_LAST, error=1.0, seed=100 + seed)
        # Both ends know the same biases.
        last = last._replace(gyro_bias=first.gyro_bias, accel_bias=first.accel_bias)
        found = _bridged(sensor(noise=1.0), first, last)
        error = np.concatenate(_errors(found), axis=1)
        middle = len(_BETWEEN) // 2
        squared.append(error[middle] @ np.linalg.solve(found.covariance[middle], error[middle]))
    assert 2.0 < np.mean(squared) < 12.0  # 6 if both are independent


def test_uncertainty_is_largest_in_the_middle() -> None:
    found = _bridged(sensor(noise=1.0), _end(_FIRST), _end(_LAST))
    sigma = np.sqrt(found.covariance[:, 3, 3])
    assert 3 < int(sigma.argmax()) < len(sigma) - 4
    assert sigma[0] < 0.5 * sigma.max() and sigma[-1] < 0.5 * sigma.max()


def test_missing_samples_are_not_bridged() -> None:
    source = sensor()
    stamps = source.samples.stamps_ns
    kept = (stamps < _FIRST + 500_000_000) | (stamps > _FIRST + 800_000_000)
    samples = type(source.samples)(
        stamps[kept], source.samples.gyro[kept], source.samples.accel[kept]
    )
    broken = Sensor(samples, source.cam0_from_imu)
    assert bridge(_end(_FIRST), _end(_LAST), _BETWEEN, SampleReader(broken), NOISE) is None


@pytest.mark.parametrize(("start", "goal"), [(_FIRST, _LAST), (_LAST, _FIRST)])
def test_velocity_is_known_at_other_times(start: int, goal: int) -> None:
    found = moved_to(_end(start), _end(goal, is_known=False), SampleReader(sensor()), NOISE)
    expected = _end(goal)
    assert found is not None and found.velocity is not None and expected.velocity is not None
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=5e-4)
    assert found.covariance[0, 0] > expected.covariance[0, 0]
