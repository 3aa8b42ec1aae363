"""Time offset, rotation and bias of a gyroscope against a camera: exact without noise."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.transforms import rotation_angle, so3_exp, so3_log
from vo.base.types import Floats, Ints
from vo.engine.geometry.gyro_alignment import Rotations, align_gyro

START_NS = 1_700_000_000_000_000_000
CAM_FROM_IMU = so3_exp(np.array([1.2, -0.7, 0.4]))
BIAS = np.array([0.01, -0.02, 0.005])
RATE_HZ = 200.0


def gyro_rates(times: Floats, planar: bool = False) -> Floats:
    """Angular rates (N, 3) of a hand-held sensor, without bias."""
    x = 0.9 * np.sin(4.1 * times) + 0.4 * np.sin(9.7 * times + 1.0)
    if planar:
        return np.outer(x, [0.0, 0.6, 0.8])
    y = 0.7 * np.sin(5.3 * times + 2.0)
    return np.stack([x, y, 0.6 * np.cos(3.3 * times) + 0.3 * np.sin(11.0 * times)], axis=1)


def measured(
    offset_s: float, noise_rad: float = 0.0, planar: bool = False
) -> tuple[Rotations, Ints, Floats]:
    """Rotations of a camera at 20 Hz over 10 s, and samples of a gyroscope with its own clock."""
    fine = np.arange(0.0, 10.5, 5e-4)
    poses = [np.eye(3)]
    for rate in gyro_rates(fine[:-1] + 2.5e-4, planar):
        poses.append(poses[-1] @ so3_exp(5e-4 * rate))
    rows = np.arange(200, len(fine) - 200, 100)
    rng = np.random.default_rng(3)
    rotvec = np.array(
        [
            CAM_FROM_IMU @ so3_log(poses[a].T @ poses[b])
            for a, b in zip(rows[:-1], rows[1:], strict=True)
        ]
    )
    rotvec += noise_rad * rng.standard_normal(rotvec.shape)
    image_ns = START_NS + np.round(1e9 * fine[rows]).astype(np.int64)
    times = np.arange(0.0, 10.4, 1.0 / RATE_HZ)
    gyro = gyro_rates(times, planar) + BIAS
    stamps_ns = START_NS + np.round(1e9 * (times + offset_s)).astype(np.int64)
    return Rotations(image_ns[:-1], image_ns[1:], rotvec), stamps_ns, gyro


@pytest.mark.parametrize("offset_ms", [-250.0, -50.0, -3.3, 0.0, 7.7, 50.0])
def test_exact_without_noise(offset_ms: float) -> None:
    found = align_gyro(*measured(1e-3 * offset_ms))
    assert found is not None
    assert 1e3 * found.time_offset_s == pytest.approx(offset_ms, abs=0.03)
    assert rotation_angle(found.cam_from_imu @ CAM_FROM_IMU.T) < 1e-3
    assert found.gyro_bias == pytest.approx(BIAS, abs=2e-4)


def test_noise_stays_within_its_standard_deviation() -> None:
    errors = []
    for offset_ms in (-40.0, 0.0, 25.0):
        rotations, stamps_ns, gyro = measured(1e-3 * offset_ms, noise_rad=1e-3)
        rng = np.random.default_rng(round(offset_ms) + 100)
        rotations.rotvec[rng.random(len(rotations.rotvec)) < 0.15] += 0.3  # outliers
        found = align_gyro(rotations, stamps_ns, gyro)
        assert found is not None and found.time_offset_sd_s < 1e-3
        errors.append(1e3 * found.time_offset_s - offset_ms)
        assert abs(errors[-1]) < 4e3 * found.time_offset_sd_s
        assert rotation_angle(found.cam_from_imu @ CAM_FROM_IMU.T) < 5 * found.rotation_sd_rad
    assert max(map(abs, errors)) < 1.0


@pytest.mark.parametrize("signs", [(1, 1, -1), (-1, -1, -1), (1, -1, 1)])
def test_mirrored_axes(signs: tuple[int, int, int]) -> None:
    rotations, stamps_ns, gyro = measured(0.02, noise_rad=1e-3)
    found = align_gyro(rotations, stamps_ns, gyro * signs)
    assert found is not None and found.is_mirrored
    assert found.time_offset_s == pytest.approx(0.02, abs=1e-3)
    assert found.cam_from_imu * signs == pytest.approx(CAM_FROM_IMU, abs=0.01)


def test_rotation_about_one_axis_leaves_an_angle_open() -> None:
    found = align_gyro(*measured(0.01, planar=True))
    assert found is not None and found.rotation_sd_rad == np.inf and not found.is_mirrored
    assert found.time_offset_s == pytest.approx(0.01, abs=1e-4)
    assert abs(found.main_axis) == pytest.approx([0.0, 0.6, 0.8], abs=1e-3)
    axis = found.main_axis
    assert found.cam_from_imu @ axis == pytest.approx(CAM_FROM_IMU @ axis, abs=1e-3)


def test_nothing_is_found_where_there_is_nothing() -> None:
    rotations, stamps_ns, gyro = measured(0.0, noise_rad=1e-3)
    rng = np.random.default_rng(0)
    shuffled = rotations._replace(rotvec=rng.permutation(rotations.rotvec))
    assert align_gyro(shuffled, stamps_ns, gyro) is None  # another recording
    assert align_gyro(rotations, stamps_ns, gyro * 57.3) is None  # degrees
    assert align_gyro(rotations, stamps_ns + 10**12, gyro) is None  # another clock
    still = rotations._replace(rotvec=1e-5 * rng.standard_normal(rotations.rotvec.shape))
    assert align_gyro(still, stamps_ns, gyro) is None
    assert align_gyro(rotations, stamps_ns[:3], gyro[:3]) is None
    few = Rotations(*(values[:5] for values in rotations))
    assert align_gyro(few, stamps_ns, gyro) is None
