"""`vo info` compares the gyroscope with the rotation of the images, and finds clipped samples."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats, Ints
from vo.tools.inspection.inertial import saturated
from vo.tools.inspection.inspection import inspect
from vo.tools.inspection.opening import open_leniently
from vo.tools.inspection.reports import ImuReport, Report

HALL = Path(__file__).parents[3] / ".." / "shared" / "data" / "rendered_hall_stereo"
Change = Callable[[Ints, Floats], tuple[Ints, Floats]]


@pytest.fixture
def walk(synthetic_stereo: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(synthetic_stereo, tmp_path / "walk"))


def rewritten(walk: Path, change: Change) -> None:
    """Change stamps (N,) and values (N, 6) of the samples."""
    table = walk / "mav0" / "imu0" / "data.csv"
    heading, *lines = table.read_text().splitlines()
    stamps = np.array([int(line.split(",")[0]) for line in lines])
    values = np.array([[float(v) for v in line.split(",")[1:]] for line in lines])
    stamps, values = change(stamps, values)
    rows = zip(stamps.tolist(), values.tolist(), strict=True)
    text = "\n".join(f"{stamp},{','.join(map(repr, row))}" for stamp, row in rows)
    table.write_text(f"{heading}\n{text}\n")


def turned(rotation: Floats) -> Change:
    return lambda stamps, values: (
        stamps,
        np.hstack([values[:, :3] @ rotation.T, values[:, 3:] @ rotation.T]),
    )


def report_of(path: Path) -> tuple[ImuReport, str]:
    report: Report = inspect(open_leniently(path))
    (imu,) = report.imu
    return imu, "\n".join(f"{each.what}; {each.advice}" for each in report.findings)


def test_a_sound_sensor_agrees_with_the_images(synthetic_stereo: Path) -> None:
    imu, text = report_of(synthetic_stereo)
    motion = imu.motion
    assert motion is not None and motion.fits and motion.time_offset_ms is not None
    assert abs(motion.time_offset_ms) < 3.0
    assert motion.rotation_error_deg is not None and motion.rotation_error_deg < 2.0
    assert "data.csv" not in text  # no finding about the sensor
    assert inspect(open_leniently(synthetic_stereo), 2).imu[0].motion is None


@pytest.mark.parametrize("offset_ms", [-50, 20])
def test_a_time_offset_is_found(walk: Path, offset_ms: int) -> None:
    rewritten(walk, lambda stamps, values: (stamps + offset_ms * 1_000_000, values))
    imu, text = report_of(walk)
    assert imu.motion is not None and imu.motion.time_offset_ms is not None
    assert imu.motion.time_offset_ms == pytest.approx(offset_ms, abs=3.0)
    assert "ms must be added to stamps of images to get its clock" in text
    assert f"give imu: {{time_offset_s: {1e-3 * imu.motion.time_offset_ms:.4f}}}" in text


def test_wrong_axes_are_found(walk: Path) -> None:
    rewritten(walk, turned(so3_exp(np.array([0.0, 0.0, np.pi / 2]))))
    assert (
        "its orientation on the camera is off by 90 degrees; by the motion, right is"
        in (report_of(walk)[1])
    )


def test_a_flipped_axis_is_found(walk: Path) -> None:
    rewritten(walk, lambda stamps, values: (stamps, values * [1, -1, 1, 1, -1, 1]))
    assert "the axes of the gyroscope form a left-handed frame" in report_of(walk)[1]


def test_the_inverse_pose_is_found(walk: Path) -> None:
    sensor = walk / "mav0" / "imu0" / "sensor.yaml"
    data = yaml.safe_load(sensor.read_text())
    camera = yaml.safe_load((walk / "mav0" / "cam0" / "sensor.yaml").read_text())
    body_from_cam = np.array(camera["T_BS"]["data"]).reshape(4, 4)
    # The pose of the sensor on the camera becomes that of the camera on the sensor.
    data["T_BS"]["data"] = (body_from_cam @ body_from_cam).ravel().tolist()
    sensor.write_text(yaml.safe_dump(data))
    assert "its inverse fits: it is probably given in the other direction" in report_of(walk)[1]


def test_degrees_are_found_by_the_images(walk: Path) -> None:
    rewritten(walk, lambda stamps, values: (stamps, values * ([180 / np.pi] * 3 + [1] * 3)))
    assert "times those of the images: probably in degrees per second" in report_of(walk)[1]


def test_samples_of_another_recording_do_not_fit(walk: Path) -> None:
    def shuffled(stamps: Ints, values: Floats) -> tuple[Ints, Floats]:
        return stamps, values[::-1]

    rewritten(walk, shuffled)
    assert "angular rates do not match the rotation of the images" in report_of(walk)[1]


def test_another_clock_is_told_by_how_much(walk: Path) -> None:
    rewritten(walk, lambda stamps, values: (stamps - 1_600_000_000_000_000_000, values))
    imu, text = report_of(walk)
    assert imu.motion is None and imu.clock_ahead_s is not None
    assert "its first sample is 1600000001." in text and "s before the first image" in text


def test_clipped_samples_are_found(walk: Path) -> None:
    rewritten(
        walk,
        lambda stamps, values: (stamps, np.clip(2.0 * values, [-2.18] * 3 + [-19.6] * 3, 19.6)),
    )
    imu, text = report_of(walk)
    assert imu.accel_saturated > 0.0
    assert "accelerations are clipped at the end of the range" in text


def test_saturation_of_a_range() -> None:
    times = np.arange(0.0, 25.0, 5e-3)[:, None]
    noise = np.random.default_rng(2).normal(0.0, 0.05, (len(times), 3))
    swing = 5.0 * np.sin(times * [2.0, 3.1, 4.7]) + noise
    assert saturated(swing, 2.0) == 0.0
    clipped = saturated(np.clip(swing, -4.36, 4.36), 2.0)
    assert clipped == pytest.approx((np.abs(swing) >= 4.36).any(axis=1).mean())
    still = np.tile([0.0, 0.0, 16.0], (500, 1))
    assert saturated(still, 15.0) == 0.0
    assert saturated(np.zeros((0, 3)), 2.0) == 0.0


def test_the_upside_down_sensor_is_noted(walk: Path) -> None:
    rewritten(walk, lambda stamps, values: (stamps, values * [1, 1, 1, -1, -1, -1]))
    assert "by its pose on the camera, up is down in the images" in report_of(walk)[1]


@pytest.mark.skipif(not HALL.is_dir(), reason="../shared/data is not here")
def test_the_hall_within_two_milliseconds() -> None:
    imu, text = report_of(HALL)
    assert imu.motion is not None and imu.motion.time_offset_ms is not None
    assert abs(imu.motion.time_offset_ms) < 2.0
    assert imu.motion.rotation_error_deg is not None and imu.motion.rotation_error_deg < 1.0
    assert "imu0" not in text
