from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from motion_courses import COURSES

from data_synth.motion.imu import measure
from data_synth.motion.motions import make_path
from data_synth.motion.spline import PosePath
from data_synth.recipe import MotionName
from data_synth.records import GRAVITY_M_S2, BodyTruth, Imu
from vo.base.geometry.transforms import rotation_angle, so3_exp
from vo.base.types import Floats, ImuNoise, Ints

SILENT = ImuNoise(0.0, 0.0, 0.0, 0.0)
MEMS = ImuNoise(1.7e-4, 1.9e-5, 2.0e-3, 3.0e-3)
FIRST_NS = 1_700_000_000_000_000_000
RATE_HZ = 200.0
GRAVITY = np.array([0.0, 0.0, -GRAVITY_M_S2])


def _frames_ns(seconds: float, fps: float = 20.0) -> Ints:
    return FIRST_NS + np.round(np.arange(round(seconds * fps)) * 1e9 / fps).astype(np.int64)


def _still(seconds: float) -> PosePath:
    controls = np.tile([1.0, 2.0, 3.0, 0.4, 0.2, -0.1], (40 + round(seconds / 0.5), 1))
    return PosePath(controls, 0.5, 10, seconds)


def _integrated(imu: Imu, truth: BodyTruth, first: int, last: int) -> tuple[Floats, Floats]:
    """Rotation and position after sample `last`, from the true state at `first`."""
    rotation = truth.world_from_body[first, :3, :3]
    position, velocity = truth.world_from_body[first, :3, 3], truth.velocity[first]
    step = 1.0 / imu.rate_hz
    for i in range(first, last):
        gyro = 0.5 * (imu.gyro[i] + imu.gyro[i + 1])
        turned = rotation @ so3_exp(gyro * step)
        accel = 0.5 * (rotation @ imu.accel[i] + turned @ imu.accel[i + 1]) + GRAVITY
        position = position + step * velocity + 0.5 * step**2 * accel
        velocity = velocity + step * accel
        rotation = turned
    return rotation, position


@pytest.mark.parametrize("motion", get_args(MotionName))
def test_integrating_noiseless_samples_for_10_s_gives_the_true_pose(motion: MotionName) -> None:
    course = COURSES["ring"]
    path = make_path(motion, course, lambda p: np.full(len(p), 9.0), seconds=14.0, seed=3)
    imu, truth = measure(path, _frames_ns(14.0), FIRST_NS, rate_hz=RATE_HZ, noise=SILENT, seed=0)
    first, last = 300, 300 + round(10.0 * RATE_HZ)
    rotation, position = _integrated(imu, truth, first, last)
    end = truth.world_from_body[last]
    assert np.linalg.norm(position - end[:3, 3]) < 0.01
    assert np.rad2deg(rotation_angle(rotation.T @ end[:3, :3])) < 0.05


def test_sensor_at_rest_measures_gravity_upwards_and_no_rotation() -> None:
    path = _still(5.0)
    imu, truth = measure(path, _frames_ns(5.0), FIRST_NS, rate_hz=RATE_HZ, noise=SILENT, seed=0)
    up = truth.world_from_body[0, :3, :3].T @ np.array([0.0, 0.0, GRAVITY_M_S2])
    np.testing.assert_allclose(imu.accel, np.tile(up, (len(imu.accel), 1)), atol=1e-12)
    np.testing.assert_allclose(imu.gyro, 0.0, atol=1e-12)
    assert not truth.gyro_bias.any()
    assert not truth.accel_bias.any()


@pytest.mark.parametrize("rate_hz", [200.0, 333.0, 1000.0])
def test_stamps_are_multiples_of_the_period_and_cover_the_frames(rate_hz: float) -> None:
    frames = _frames_ns(4.0)
    imu, truth = measure(_still(4.0), frames, FIRST_NS, rate_hz=rate_hz, noise=MEMS, seed=0)
    np.testing.assert_array_equal(imu.stamps_ns, truth.stamps_ns)
    counts = (imu.stamps_ns - FIRST_NS) * rate_hz / 1e9
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6 * rate_hz)
    assert (np.diff(np.round(counts)) == 1).all()
    period_ns = 1e9 / rate_hz
    assert 1e8 - period_ns <= frames[0] - imu.stamps_ns[0] <= 1e8
    assert 1e8 - period_ns <= imu.stamps_ns[-1] - frames[-1] <= 1e8


def test_white_noise_and_random_walks_have_the_given_densities() -> None:
    noise = ImuNoise(1e-3, 2e-4, 5e-3, 1e-3)
    seconds = 300.0
    imu, truth = measure(
        _still(seconds), _frames_ns(seconds), FIRST_NS, rate_hz=RATE_HZ, noise=noise, seed=7
    )
    up = truth.world_from_body[0, :3, :3].T @ np.array([0.0, 0.0, GRAVITY_M_S2])
    for values, bias, white, walk in (
        (imu.gyro, truth.gyro_bias, noise.gyro_noise, noise.gyro_walk),
        (imu.accel - up, truth.accel_bias, noise.accel_noise, noise.accel_walk),
    ):
        residual = values - bias
        assert residual.std() == pytest.approx(white * np.sqrt(RATE_HZ), rel=0.02)
        # Averaged over a second, white noise falls to its density.
        seconds_of = residual[: 300 * 200].reshape(300, 200, 3).mean(axis=1)
        assert seconds_of.std() == pytest.approx(white, rel=0.1)
        # Over a second, a bias walks as far as its density.
        assert np.diff(bias[::200], axis=0).std() == pytest.approx(walk, rel=0.1)
        assert np.diff(bias, axis=0).std() == pytest.approx(walk / np.sqrt(RATE_HZ), rel=0.02)


def test_initial_biases_are_small_but_not_zero() -> None:
    starts = []
    for seed in range(40):
        _, truth = measure(
            _still(1.0), _frames_ns(1.0), FIRST_NS, rate_hz=RATE_HZ, noise=MEMS, seed=seed
        )
        starts.append(np.concatenate([truth.gyro_bias[0], truth.accel_bias[0]]))
    gyro, accel = np.array(starts)[:, :3].std(), np.array(starts)[:, 3:].std()
    assert 3e-4 < gyro < 1e-3
    assert 0.05 < accel < 0.2


def test_noise_depends_on_the_seed_only() -> None:
    first, again, other = (
        measure(_still(2.0), _frames_ns(2.0), FIRST_NS, rate_hz=RATE_HZ, noise=MEMS, seed=s)[0]
        for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.gyro, again.gyro)
    np.testing.assert_array_equal(first.accel, again.accel)
    assert np.abs(first.gyro - other.gyro).max() > 1e-4
