"""A sensor that contradicts the images is found by the states of a run, and no other is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_flight import (
    IMU_FROM_CAM,
    NOISE,
    START_NS,
    Sensor,
    keyframe_stamps,
    sensor,
    step_covariance,
    visual_poses,
    world_from_cam,
)
from sensor_faults import Change, added, changed, in_vehicle, restamped, scaled, shaken

from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats
from vo.engine.geometry import so3
from vo.engine.inertial.chain import InertialChain
from vo.engine.inertial.keyframe_states import Node
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.time_offset import TimeOffset, different_clocks

_COUNT = 40


def _chain(
    source: Sensor, *, is_metric: bool = False, imu_from_cam: Floats = IMU_FROM_CAM, seed: int = 3
) -> InertialChain:
    """A whole run of 20 s, with noise."""
    scale = 1.0 if is_metric else 0.5
    chain = InertialChain(SampleReader(source), NOISE, imu_from_cam, is_metric=is_metric)
    stamps = keyframe_stamps(_COUNT)
    poses = visual_poses(world_from_cam(stamps), scale, 1.0, seed=seed)
    covariance = step_covariance(1, scale)[0]
    for k in range(_COUNT):
        chain.set(Node(k, 10 * k, int(stamps[k]), 0, poses[k], covariance))
        chain.update()
    chain.finish()
    return chain


def _good() -> Sensor:
    return sensor(noise=1.0, seconds=22.0)


@pytest.mark.parametrize("is_metric", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_noise_is_no_contradiction(seed: int, *, is_metric: bool) -> None:
    chain = _chain(_good(), is_metric=is_metric, seed=seed)
    assert chain.is_initialised and chain.agreement.contradiction is None


@pytest.mark.parametrize("is_metric", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        added([0.0, 0.0, 0.0, 35.0, 0.0, 0.0], 9.0, 10.0),  # hit
        added([0.0, 0.0, 0.0, 5.0, 0.0, 0.0], 9.0, 10.0),
        added([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], 11.0, 99.0),  # biases jump
        added([0.0, 0.0, 0.0, 0.0, 0.3, 0.0], 8.0, 99.0),
        added([0.0, 0.0, 0.1, 0.0, 0.0, 0.0], 10.0, 99.0),
        added([0.02, 0.0, 0.0, 0.0, 0.0, 0.0], 12.0, 99.0),
        in_vehicle([-1.2, 0.0, 0.0], 6.0, 11.0),
        in_vehicle([0.0, 0.3, 0.0], 9.0, 14.0),
        in_vehicle([0.0, 0.0, 1.0], 6.0, 8.0),
        scaled(1.0, 1.1),
        scaled(1.0, 0.93),
    ],
)
def test_faults_are_found(change: Change, *, is_metric: bool) -> None:
    chain = _chain(changed(_good(), change), is_metric=is_metric)
    assert chain.agreement.contradiction is not None or not chain.is_initialised


@pytest.mark.parametrize("rate", [1.01, 0.995])
def test_another_rate_of_the_clock_is_found(rate: float) -> None:
    good = _good()
    since = ((good.stamps_ns - START_NS) * rate).astype(np.int64)
    assert _chain(restamped(good, START_NS + since)).agreement.contradiction is not None


def test_a_wrong_pose_is_found() -> None:
    turned = make_transform(so3.exp(np.array([[0.05, 0.0, 0.0]]))[0], np.zeros(3)) @ IMU_FROM_CAM
    assert _chain(_good(), imu_from_cam=turned).agreement.contradiction is not None


@pytest.mark.parametrize(
    "change",
    [
        added([30.0, -30.0, 30.0, 150.0, -150.0, 150.0], 9.999, 10.001),
        added([0.0, 0.0, 0.0, 60.0, 0.0, 0.0], 10.0, 10.04),
        shaken(30.0, 10.0, 10.3),
        shaken(4.0, 9.0, 9.5),
    ],
)
def test_bad_samples_that_are_refused_leave_the_rest_usable(change: Change) -> None:
    right, chain = _chain(_good()), _chain(changed(_good(), change))
    assert chain.agreement.contradiction is None
    assert chain.newest is not None and right.newest is not None
    states, expected = chain.newest.estimate.states, right.newest.estimate.states
    np.testing.assert_allclose(states.log_scale, expected.log_scale, atol=0.005)
    np.testing.assert_allclose(states.accel_bias, expected.accel_bias, atol=0.02)


def test_a_world_before_a_long_gap_is_tested_too() -> None:
    source = changed(_good(), added([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], 5.0, 9.0))
    samples = source.samples
    kept = np.abs(1e-9 * (samples.stamps_ns - START_NS) - 12.0) > 2.0
    samples = replace(
        samples,
        stamps_ns=samples.stamps_ns[kept],
        gyro=samples.gyro[kept],
        accel=samples.accel[kept],
    )
    chain = InertialChain(
        SampleReader(replace(source, samples=samples)), NOISE, IMU_FROM_CAM, is_metric=True
    )
    stamps = keyframe_stamps(_COUNT)
    poses, covariance = visual_poses(world_from_cam(stamps), 1.0, 1.0), step_covariance(1, 1.0)[0]
    rows = [k for k in range(_COUNT) if abs(1e-9 * (stamps[k] - START_NS) - 12.0) > 2.0]
    for k in rows:
        chain.set(Node(k, 10 * k, int(stamps[k]), int(k > 20), poses[k], covariance))
        chain.update()
    assert chain.agreement.contradiction is not None


def test_small_faults_make_stated_errors_larger() -> None:
    right, chain = _chain(_good()), _chain(changed(_good(), scaled(1.0, 1.006)))
    assert chain.agreement.contradiction is None
    assert chain.agreement.excess > max(2.5, right.agreement.excess)


def test_a_clock_that_drifts_is_named() -> None:
    first = TimeOffset(0.002, 0.0003)
    assert different_clocks(first, TimeOffset(0.0025, 0.0003)) is None
    assert different_clocks(first, TimeOffset(0.012, 0.004)) is None
    assert different_clocks(first, None) is None
    found = different_clocks(first, TimeOffset(0.05, 0.001))
    assert found is not None and "+2.0 ms" in found and "+50.0 ms" in found
