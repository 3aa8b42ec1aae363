"""Orientations of a camera that only turns."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from inertial_flight import GYRO_BIAS, IMU_FROM_CAM, NOISE, START_NS, Samples, Sensor

from vo.base.geometry.transforms import inverse, make_transform, rotation_angle
from vo.base.types import Floats, Ints, KeyframePose
from vo.engine.geometry import so3
from vo.engine.inertial.prediction import InertialPredictor
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.turning import TurnLog, orientations, turning_between, upright_from_first
from vo.engine.inertial_path.turns import InertialTurns
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.trajectory.inertial_frames import InertialFrame

_MATRIX = np.array([[300.0, 0.0, 200.0], [0.0, 300.0, 150.0], [0.0, 0.0, 1.0]])
_FRAMES = START_NS + 100_000_000 + np.arange(80) * 100_000_000
_TILT = so3.exp(np.array([[0.1, -0.2, 0.0]]))[0]  # world_from_imu at the start


def _rotation(stamps_ns: Ints) -> Floats:
    """world_from_imu: half a turn about the vertical, with some nodding."""
    t = 1e-9 * (stamps_ns - START_NS)
    yaw, pitch = np.zeros((2, len(t), 3))
    yaw[:, 2], pitch[:, 1] = 0.4 * t, 0.2 * np.sin(t)
    return np.asarray(so3.exp(yaw) @ _TILT @ so3.exp(pitch))


def _sensor(gyro_sign: float = 1.0) -> Sensor:
    stamps = START_NS + np.arange(1800) * 5_000_000
    rotation, step_ns = _rotation(stamps), 1_000
    later = _rotation(stamps + step_ns)
    rate = so3.log(np.swapaxes(rotation, 1, 2) @ later) / (1e-9 * step_ns)
    white = NOISE.gyro_noise * np.sqrt(200.0) * np.random.default_rng(2).standard_normal(rate.shape)
    force = np.swapaxes(rotation, 1, 2) @ np.array([0.0, 0.0, 9.81])
    samples = Samples(stamps, gyro_sign * rate + GYRO_BIAS + white, force)
    return Sensor(samples, inverse(IMU_FROM_CAM))


def _camera(stamps_ns: Ints) -> Floats:
    """(n, 3, 3) true world_from_cam."""
    return np.asarray(_rotation(stamps_ns) @ IMU_FROM_CAM[:3, :3])


def _log(*, outliers: float = 0.2) -> TurnLog:
    """Rotations between each tenth image and those after it, of matches with noise of 0.3 px."""
    rng, log = np.random.default_rng(4), TurnLog()
    for begin in range(0, len(_FRAMES) - 10, 10):
        for k in range(begin + 1, begin + 10):
            first, second = _camera(_FRAMES[[begin, k]])
            xy = rng.uniform([0, 0], [400, 300], (120, 2))
            rays = np.column_stack([xy, np.ones(120)]) @ np.linalg.inv(_MATRIX).T
            seen = rays @ (second.T @ first).T @ _MATRIX.T
            there = seen[:, :2] / seen[:, 2:] + 0.3 * rng.standard_normal((120, 2))
            wrong = rng.random(120) < outliers
            there[wrong] += rng.uniform(-80, 80, (int(wrong.sum()), 2))
            log.add((int(_FRAMES[begin]), int(_FRAMES[k])), xy, there, _MATRIX)
    return log


def test_a_rotation_is_found_among_outliers() -> None:
    for turn in _log().turns:
        first, last = _camera(np.array([turn.first_ns, turn.last_ns]))
        assert rotation_angle(turn.last_from_first @ (last.T @ first).T) < 1.5e-3
        assert turn.residual_px < 1.0


def test_the_bias_of_the_gyroscope_is_found() -> None:
    reader = SampleReader(_sensor())
    times = int(_FRAMES[0]), int(_FRAMES[-1])
    found = turning_between(_log().turns, times, reader, IMU_FROM_CAM)
    assert found is not None
    assert np.abs(found.gyro_bias - GYRO_BIAS).max() < min(3 * found.sigma_rad_s, 5e-4)


def test_orientations_are_right_and_upright() -> None:
    reader = SampleReader(_sensor())
    times = int(_FRAMES[0]), int(_FRAMES[-1])
    turning = turning_between(_log().turns, times, reader, IMU_FROM_CAM)
    assert turning is not None
    found = orientations(turning, _FRAMES, reader, IMU_FROM_CAM, NOISE)
    assert found is not None
    true = _camera(_FRAMES)
    angles = [
        rotation_angle(true[0].T @ true[k] @ found.first_from_cam[k].T) for k in range(len(true))
    ]
    assert max(angles) < np.radians(0.2)
    assert all(np.diff(found.sigma_rad) > 0) and max(angles) < 4 * found.sigma_rad[-1]
    world = upright_from_first(found.up) @ found.first_from_cam
    up = (world @ np.swapaxes(true, 1, 2))[:, 2, 2]
    assert np.degrees(np.arccos(np.clip(up, -1.0, 1.0))).max() < 0.3


def test_a_gyroscope_with_wrong_axes_is_not_believed() -> None:
    reader = SampleReader(_sensor(gyro_sign=-1.0))
    times = int(_FRAMES[0]), int(_FRAMES[-1])
    assert turning_between(_log().turns, times, reader, IMU_FROM_CAM) is None


def _parts(
    builder: TrajectoryBuilder, log: TurnLog, source: Sensor
) -> tuple[TrajectoryBuilder, InertialPredictor, SampleReader, Floats]:
    reader = SampleReader(source)
    predictor = InertialPredictor(reader, NOISE, IMU_FROM_CAM)
    predictor.turns = log
    return builder, predictor, reader, IMU_FROM_CAM


def _turned(tracked: Ints) -> tuple[TrajectoryBuilder, list[InertialFrame]]:
    """All frames were reached, and some of them have a pose, relative to one keyframe."""
    builder, source = TrajectoryBuilder(np.eye(4)), _sensor()
    for k, stamp in enumerate(_FRAMES.tolist()):
        frame: Any = SimpleNamespace(index=k, stamp_ns=stamp)
        builder.reach(frame)
        if k in tracked:
            pose = make_transform(_camera(np.array([stamp]))[0], np.array([1.0, 2.0, 3.0]))
            if k == tracked[0]:
                builder.store.store(0, KeyframePose(k, stamp, 0, pose, None))
            builder.store.add(k, stamp, 0, 0, pose)
    turns = InertialTurns(*_parts(builder, _log(), source))
    return builder, turns.turned([])


@pytest.mark.parametrize("tracked", [np.arange(5), np.arange(75, 80)])
def test_frames_turn_from_the_tracked_one_beside_them(tracked: Ints) -> None:
    builder, frames = _turned(tracked)
    builder.store.add_inertial(frames)
    path = builder.store.path()
    assert path.frame_index.tolist() == list(range(80)) and path.inertial is not None
    assert ((path.inertial == 0) == np.isin(np.arange(80), tracked)).all()
    assert set(path.inertial.tolist()) == {0, -2}
    poses = path.trajectory.world_from_cam
    np.testing.assert_allclose(poses[:, :3, 3], np.tile([1.0, 2.0, 3.0], (80, 1)), atol=1e-9)
    true = _camera(_FRAMES)
    assert max(rotation_angle(a @ b.T) for a, b in zip(poses[:, :3, :3], true, strict=True)) < 4e-3


def test_without_any_map_the_first_frame_is_the_origin_of_an_upright_world() -> None:
    builder, frames = _turned(np.empty(0, np.int64))
    builder.store.add_inertial(frames)
    path = builder.store.path()
    assert path.frame_index.tolist() == list(range(80)) and not path.is_keyframe.any()
    assert (path.trajectory.positions == 0.0).all()
    covariance = builder.store.covariances()[40].covariance
    assert covariance is not None and covariance[3, 3] == pytest.approx(1e6)
    assert 1e-9 < covariance[0, 0] < 1e-4
    true, found = _camera(_FRAMES), path.trajectory.world_from_cam[:, :3, :3]
    up = (found @ np.swapaxes(true, 1, 2))[:, 2, 2]
    assert np.degrees(np.arccos(np.clip(up, -1.0, 1.0))).max() < 0.3


def test_frames_far_from_any_image_that_shows_a_turn_have_no_orientation() -> None:
    builder, source = TrajectoryBuilder(np.eye(4)), _sensor()
    for k, stamp in enumerate(_FRAMES.tolist()):
        frame: Any = SimpleNamespace(index=k, stamp_ns=stamp)
        builder.reach(frame)
    log = _log()
    log.turns = [turn for turn in log.turns if turn.last_ns < _FRAMES[40]]
    turns = InertialTurns(*_parts(builder, log, source))
    assert [frame.frame_index for frame in turns.turned([])] == list(range(50))
