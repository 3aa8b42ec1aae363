"""Orientation and time offset of a sensor whose pose on the camera is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.transforms import make_transform, rotation_angle, so3_exp, so3_log
from vo.base.types import Estimate, Floats, State
from vo.recordings.sources.imu import FileImu, make_samples
from vo.runs.sensor_alignment import align_sensor

CAM_FROM_IMU = so3_exp(np.array([0.3, -1.2, 0.8]))
OFFSET_S = 0.043


def rates(times: Floats, amplitude: float) -> Floats:
    """(N, 3) of a hand that shakes the camera about all axes, in its frame."""
    phases = np.array([2.1, 3.3, 4.7]) * times[:, None] + np.array([0.0, 1.0, 2.0])
    return amplitude * np.sin(phases)


def path_and_sensor(amplitude: float, seed: int = 1) -> tuple[list[Estimate], FileImu]:
    times = np.arange(0.0, 8.0, 0.001)
    rotation, frames = np.eye(3), []
    for n, rate in enumerate(rates(times, amplitude)):
        if n % 33 == 0:
            pose = make_transform(rotation.copy(), np.zeros(3))
            stamp_ns = round(1e9 * times[n])
            frames.append(
                Estimate(len(frames), stamp_ns, State.TRACKING, None, 0, pose, False, 9, 9, 9, ())
            )
        rotation = rotation @ so3_exp(0.001 * rate)
    samples = np.arange(-1.0, 9.0, 0.005)
    rng = np.random.default_rng(seed)
    gyro = rates(samples, amplitude) @ CAM_FROM_IMU + rng.normal(0.0, 0.002, (len(samples), 3))
    stamps = np.rint(1e9 * (samples + OFFSET_S)).astype(np.int64)
    read = make_samples(stamps.tolist(), np.hstack([gyro, np.zeros_like(gyro)]), 0)
    return frames, FileImu("imu.csv", lambda: read, lambda: None)


def test_a_sensor_is_turned_as_the_path_turns() -> None:
    found = align_sensor(*reversed(path_and_sensor(0.8)))
    assert found is not None and found.cam0_from_imu is not None
    assert np.degrees(rotation_angle(found.cam0_from_imu[:3, :3] @ CAM_FROM_IMU.T)) < 0.3
    assert found.time_offset_s == pytest.approx(OFFSET_S, abs=0.001)
    assert found.cam0_from_imu[:3, 3] == pytest.approx([0.0, 0.0, 0.0], abs=0.002)


def moving(seconds: float) -> Floats:
    """Pose of a camera that is shaken while it is carried in circles, in units of half a metre."""
    turn = np.array([0.4 * np.sin(2.5 * seconds), 0.5 * np.cos(2.1 * seconds), 0.3 * seconds])
    place = 2.0 * np.array(
        [np.sin(seconds), 0.5 * np.cos(1.3 * seconds), 0.2 * np.sin(3 * seconds)]
    )
    return make_transform(so3_exp(turn), place)


def test_the_lever_arm_is_found_where_the_camera_moves() -> None:
    arm = np.array([0.05, -0.08, 0.03])  # of the sensor, in the frame of the camera
    up = np.array([0.0, 0.0, 9.81])

    def centre(seconds: float) -> Floats:
        pose = moving(seconds)
        return np.asarray(0.5 * pose[:3, 3] + pose[:3, :3] @ arm)

    rows, step = [], 1e-3
    times = np.arange(-0.5, 12.5, 0.005)
    for seconds in times:
        before, now, after = (centre(seconds + n * step) for n in (-1, 0, 1))
        rotation = moving(seconds)[:3, :3]
        force = rotation.T @ ((before - 2.0 * now + after) / step**2 + up)
        between = moving(seconds - step)[:3, :3].T @ moving(seconds + step)[:3, :3]
        rate = so3_log(between) / (2.0 * step)
        rows.append(np.concatenate([CAM_FROM_IMU.T @ rate, CAM_FROM_IMU.T @ force]))
    stamps = np.rint(1e9 * (times + OFFSET_S)).astype(np.int64)
    read = make_samples(stamps.tolist(), np.array(rows), 0)
    path = [
        Estimate(n, 50_000_000 * n, State.TRACKING, None, 0, moving(0.05 * n), False, 9, 9, 9, ())
        for n in range(240)
    ]
    found = align_sensor(FileImu("imu.csv", lambda: read, lambda: None), path)
    assert found is not None and found.cam0_from_imu is not None
    assert found.cam0_from_imu[:3, 3] == pytest.approx(arm, abs=0.003)


def test_a_camera_that_hardly_turns_shows_nothing() -> None:
    path, sensor = path_and_sensor(0.002)
    assert align_sensor(sensor, path) is None
    assert align_sensor(sensor, path[:2]) is None


def test_a_sensor_of_another_recording_does_not_fit() -> None:
    path, _ = path_and_sensor(0.8)
    stamps = np.arange(0, 8_000_000_000, 5_000_000)
    noise = np.random.default_rng(3).normal(0.0, 0.5, (len(stamps), 6))
    other = make_samples(stamps.tolist(), noise, 0)
    assert align_sensor(FileImu("imu.csv", lambda: other, lambda: None), path) is None
