"""Faults of the inertial sensor; the truth stays that of the path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import make_recording, make_shots

from data_synth.motion.imu import with_effects
from data_synth.recipe import ImuRecipe
from data_synth.records import GRAVITY_M_S2, Imu
from vo.base.geometry.transforms import rotation_angle
from vo.base.types import ImuNoise

SILENT = ImuNoise(0.0, 0.0, 0.0, 0.0)
RATE_HZ = 400.0


def still(seconds: float) -> Imu:
    stamps = (np.arange(round(seconds * RATE_HZ)) * 1e9 / RATE_HZ).astype(np.int64) + 10**18
    gyro = np.zeros((len(stamps), 3))
    return Imu(stamps, gyro, gyro + [0.0, 0.0, GRAVITY_M_S2], RATE_HZ, SILENT)


def test_nothing_changes_by_default() -> None:
    imu = still(1.0)
    same = with_effects(imu, ImuRecipe(), 3)
    assert np.array_equal(same.stamps_ns, imu.stamps_ns) and same.recorded_pose is None
    assert np.array_equal(same.accel, imu.accel) and np.array_equal(same.gyro, imu.gyro)


def test_the_clock_is_ahead_by_the_offset() -> None:
    imu = still(1.0)
    late = with_effects(imu, ImuRecipe(time_offset_ms=-12.5), 0)
    assert np.array_equal(late.stamps_ns - imu.stamps_ns, np.full(len(imu.stamps_ns), -12_500_000))


@pytest.mark.parametrize("effect", [{"vibration": 2.0}, {"bumps": 5.0}])
def test_integrated_vibration_and_bumps_stay_within_millimetres(effect: dict[str, float]) -> None:
    imu = still(10.0)
    shaken = with_effects(imu, ImuRecipe(**effect), 1)
    accel = shaken.accel - imu.accel
    assert np.abs(accel).max() > 3.0
    step = 1.0 / RATE_HZ
    velocity = np.cumsum(0.5 * step * (accel[1:] + accel[:-1]), axis=0)
    velocity -= velocity.mean(axis=0)  # of an oscillation from its middle
    position = np.cumsum(step * velocity, axis=0)
    assert np.abs(position).max() < 0.01
    angle = np.cumsum(step * shaken.gyro, axis=0)
    assert np.abs(angle).max() < 1e-3


def test_strength_of_vibration() -> None:
    imu = still(20.0)
    shaken = with_effects(imu, ImuRecipe(vibration=0.5), 0)
    rms = np.sqrt(np.mean(np.sum((shaken.accel - imu.accel) ** 2, axis=1)))
    assert rms == pytest.approx(1.0, rel=0.01)
    assert np.sqrt(np.mean(np.sum(shaken.gyro**2, axis=1))) == pytest.approx(0.015, rel=0.01)


def test_number_and_height_of_bumps() -> None:
    imu = still(100.0)
    accel = with_effects(imu, ImuRecipe(bumps=1.0), 4).accel[:, 2] - GRAVITY_M_S2
    starts = np.count_nonzero((accel[1:] > 15.0) & (accel[:-1] == 0.0))
    assert 10 <= starts <= 32  # 20 on average
    assert np.abs(accel).max() == pytest.approx(20.0, rel=0.05)


def test_ranges_clip() -> None:
    imu = replace(still(1.0), gyro=np.tile([9.0, -9.0, 1.0], (400, 1)))
    clipped = with_effects(imu, ImuRecipe(gyro_range_deg_s=250.0, accel_range_g=0.5), 0)
    assert clipped.gyro[7] == pytest.approx([4.3633, -4.3633, 1.0], abs=1e-4)
    assert clipped.accel[7] == pytest.approx([0.0, 0.0, 0.5 * GRAVITY_M_S2])


def test_the_recorded_pose_is_off_by_what_was_chosen(tmp_path: Path) -> None:
    from data_synth.writers import euroc, mcap
    from vo.recordings.sources.registry import open_source

    recording = make_recording()
    assert recording.imu is not None
    settings = ImuRecipe(rotation_error_deg=3.0, translation_error_m=0.05)
    wrong = with_effects(recording.imu, settings, 2)
    assert wrong.recorded_pose is not None
    for error, name in ((None, "right"), (wrong.recorded_pose, "wrong")):
        changed = replace(recording, imu=replace(recording.imu, recorded_pose=error))
        euroc.write(tmp_path / name, changed, make_shots(changed), "png")
        mcap.write_foxglove(tmp_path / f"{name}.mcap", changed, make_shots(changed), "png")
    for suffix in ("", ".mcap"):
        poses = []
        for name in ("right", "wrong"):
            pose = open_source(tmp_path / f"{name}{suffix}").imus[0].cam0_from_imu
            assert pose is not None
            poses.append(pose)
        off = np.linalg.inv(poses[0]) @ poses[1]
        assert np.degrees(rotation_angle(off[:3, :3])) == pytest.approx(3.0, abs=1e-6)
        assert np.linalg.norm(off[:3, 3]) == pytest.approx(0.05, abs=1e-9)
