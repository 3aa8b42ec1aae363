"""Prediction of poses by a gyroscope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from inertial_flight import IMU_FROM_CAM, START_NS, Samples, Sensor, sensor, world_from_cam

from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.types import Floats, Ints
from vo.engine.inertial.samples import SampleReader
from vo.engine.tracking.inertial_motion import GyroMotion
from vo.engine.tracking.motion_model import ConstantVelocity, MotionModel

_STAMPS = START_NS + 1_000_000_000 + np.arange(60) * 50_000_000


def _fed(motion: MotionModel, stamps: Ints, poses: Floats) -> MotionModel:
    motion.restart(int(stamps[0]), poses[0])
    for stamp, pose in zip(stamps[1:].tolist(), poses[1:], strict=True):
        motion.update(stamp, pose)
    return motion


def _gyro(source: Sensor) -> GyroMotion:
    return GyroMotion(SampleReader(source), IMU_FROM_CAM)


def _angle(first: Floats, second: Floats) -> float:
    return rotation_angle((inverse(first) @ second)[:3, :3])


def test_rotation_is_predicted_across_a_second_without_images() -> None:
    poses = world_from_cam(_STAMPS)
    later = int(_STAMPS[-1]) + 1_000_000_000
    (truth,) = world_from_cam(np.array([later]))
    gyro = _fed(_gyro(sensor(noise=1.0)), _STAMPS, poses)
    usual = _fed(ConstantVelocity(), _STAMPS, poses)
    assert _angle(gyro.predict(later), truth) < 2e-3  # its bias is learnt
    assert _angle(usual.predict(later), truth) > 0.1


def test_position_goes_on_with_the_last_velocity_in_the_world() -> None:
    poses = world_from_cam(_STAMPS)
    gyro = _fed(_gyro(sensor()), _STAMPS, poses)
    step = poses[-1, :3, 3] - poses[-2, :3, 3]
    found = gyro.predict(int(_STAMPS[-1]) + 100_000_000)
    np.testing.assert_allclose(found[:3, 3], poses[-1, :3, 3] + 2 * step, atol=1e-12)


def test_prediction_follows_a_moved_map() -> None:
    poses = world_from_cam(_STAMPS)
    gyro = _fed(_gyro(sensor()), _STAMPS, poses)
    later = int(_STAMPS[-1]) + 100_000_000
    before, motion = gyro.predict(later), poses[10]
    gyro.move(motion)
    np.testing.assert_allclose(gyro.predict(later), motion @ before, atol=1e-12)


def test_a_wrong_gyroscope_is_never_trusted() -> None:
    poses, source = world_from_cam(_STAMPS), sensor()
    given = source.samples
    wrong = (
        given.gyro * [-1.0, -1.0, 1.0],
        given.gyro[:, [1, 2, 0]],
        np.roll(given.gyro, 300, 0),
        np.degrees(given.gyro),
    )
    later = int(_STAMPS[-1]) + 50_000_000
    expected = _fed(ConstantVelocity(), _STAMPS, poses).predict(later)
    for gyro in wrong:
        other = replace(source, samples=Samples(given.stamps_ns, gyro, given.accel))
        found = _fed(_gyro(other), _STAMPS, poses)
        np.testing.assert_array_equal(found.predict(later), expected)


def test_missing_samples_leave_constant_velocity() -> None:
    poses = world_from_cam(_STAMPS)
    gyro = _fed(_gyro(sensor(seconds=4.1)), _STAMPS, poses)
    later = START_NS + 5_000_000_000
    expected = _fed(ConstantVelocity(), _STAMPS, poses).predict(later)
    np.testing.assert_array_equal(gyro.predict(later), expected)
