"""Noise of an inertial sensor at rest, against that with which it was generated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import vo
from vo.base.errors import CalibrationError
from vo.base.types import Floats, ImuNoise, Ints
from vo.cli.app import app
from vo.recordings.formats.calibration.checks import make_noise
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.formats.calibration.kalibr import NOISE_KEYS
from vo.tools.calibrating.allan import allan_curve, fit_terms
from vo.tools.calibrating.imu_noise import measure_noise, warnings_of

NOISE = ImuNoise(gyro_noise=3e-4, gyro_walk=8e-5, accel_noise=2e-3, accel_walk=1e-3)
RATE_HZ = 50.0
START_NS = 1_700_000_000_000_000_000


def generated(
    seconds: float, noise: ImuNoise = NOISE, seed: int = 1
) -> tuple[Ints, Floats, Floats]:
    """Stamps (N,), gyro and accel (N, 3) of a sensor at rest."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)

    def sensor(density: float, walk: float) -> Floats:
        white = density * np.sqrt(RATE_HZ) * rng.standard_normal((count, 3))
        return white + np.cumsum(walk / np.sqrt(RATE_HZ) * rng.standard_normal((count, 3)), axis=0)

    stamps = START_NS + (np.arange(count) * 1e9 / RATE_HZ).astype(np.int64)
    gyro = sensor(noise.gyro_noise, noise.gyro_walk)
    return stamps, gyro, sensor(noise.accel_noise, noise.accel_walk) + [0.1, -0.2, 9.8]


def test_deviation_of_white_noise_and_of_a_walk() -> None:
    rng = np.random.default_rng(0)
    white = allan_curve(rng.standard_normal((40_000, 3)), 100.0)
    early = white.tau_s < 5.0
    assert white.pooled[early] == pytest.approx(0.1 / np.sqrt(white.tau_s[early]), rel=0.1)
    ramp = allan_curve(np.outer(np.arange(4000) / 100.0, [1.0, 2.0, 2.0]), 100.0)
    assert ramp.deviation == pytest.approx(np.outer(ramp.tau_s, [1, 2, 2]) / np.sqrt(2), rel=1e-6)
    assert fit_terms(ramp).ramp == pytest.approx(np.sqrt(3.0), rel=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_known_noise_within_ten_per_cent(seed: int) -> None:
    result = measure_noise(*generated(2400.0, seed=seed))
    for name in ("gyro_noise", "gyro_walk", "accel_noise", "accel_walk"):
        assert getattr(result.noise, name) == pytest.approx(getattr(NOISE, name), rel=0.1)
    assert result.gyro.terms.density_sd < 0.01 and result.gyro.terms.walk_sd < 0.1
    assert warnings_of(result) == []


def test_a_short_recording_gives_an_upper_limit_of_the_walk() -> None:
    slow = ImuNoise(3e-4, 3e-6, 2e-3, 2e-5)
    result = measure_noise(*generated(120.0, slow))
    assert result.noise.gyro_noise == pytest.approx(3e-4, rel=0.05)
    assert 3e-6 < result.noise.gyro_walk < 1e-4
    (line,) = warnings_of(result)
    assert "2 minutes do not show the random walk of the gyroscope and the accelerometer" in line


def test_motion_and_gaps_are_left_out() -> None:
    stamps, gyro, accel = generated(400.0)
    gyro[2500:3000] += 0.5 * np.sin(np.arange(500) / 5.0)[:, None]  # from 50 to 60 s
    stamps[15_000:] += 2_000_000_000  # a gap at 300 s
    result = measure_noise(stamps, gyro, accel)
    assert result.start_s == pytest.approx(60.0, abs=1.5)
    assert result.rest_s == pytest.approx(239.0, abs=2.5)
    assert result.noise.gyro_noise == pytest.approx(3e-4, rel=0.1)
    assert "only" in warnings_of(result)[0]


def test_recordings_that_cannot_be_used() -> None:
    with pytest.raises(CalibrationError, match="at rest without gaps for 30 s at most"):
        measure_noise(*generated(30.0))
    stamps, gyro, accel = generated(100.0)
    with pytest.raises(CalibrationError, match="an axis of the gyroscope is constant"):
        measure_noise(stamps, 0.0 * gyro, accel)
    with pytest.raises(CalibrationError, match="2 samples; record at least a minute"):
        measure_noise(stamps[:2], gyro[:2], accel[:2])


def write_table(path: Path, seconds: float) -> Path:
    stamps, gyro, accel = generated(seconds)
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = zip(stamps.tolist(), np.hstack([gyro, accel]).tolist(), strict=True)
    lines = [f"{stamp},{','.join(map(repr, row))}" for stamp, row in rows]
    path.write_text("\n".join(["#timestamp [ns],w,w,w,a,a,a", *lines]) + "\n")
    return path


def test_the_command_writes_what_kalibr_and_vo_read(tmp_path: Path) -> None:
    write_table(tmp_path / "rest" / "mav0" / "imu0" / "data.csv", 200.0)
    output, picture = tmp_path / "imu.yaml", tmp_path / "allan.png"
    words = ["calibrate", "--imu-noise", str(tmp_path / "rest"), "-o", str(output)]
    result = CliRunner().invoke(app, [*words, "--picture", str(picture), "--json"])
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    noise = make_noise("imu", load_document(output).data, NOISE_KEYS)
    assert noise is not None and noise.gyro_noise == pytest.approx(3e-4, rel=0.05)
    assert found["gyro"]["noise"] == pytest.approx(noise.gyro_noise, rel=1e-5)
    assert found["rest_s"] == pytest.approx(200.0, abs=1.0) and picture.stat().st_size > 10_000
    same = vo.calibrate_imu_noise(tmp_path / "rest", tmp_path / "same.yaml")
    assert (tmp_path / "same.yaml").read_bytes() == output.read_bytes()
    assert same.rest_s == pytest.approx(found["rest_s"], abs=1e-3)
    with pytest.raises(vo.OutputError, match="exists already"):
        vo.calibrate_imu_noise(tmp_path / "rest", output)
    again = CliRunner().invoke(app, words)
    assert again.exit_code == 1 and "exists already" in again.stderr
    plain = CliRunner().invoke(app, [*words, "--force"])
    assert plain.exit_code == 0 and "rad/s/√Hz" in plain.stdout


def test_a_table_alone_and_a_recording_without_sensor(tmp_path: Path) -> None:
    table = write_table(tmp_path / "samples.csv", 70.0)
    output = tmp_path / "imu.yaml"
    words = ["calibrate", "--imu-noise", "-o", str(output)]
    assert CliRunner().invoke(app, [*words, str(table)]).exit_code == 0
    for number in range(3):
        (tmp_path / "images").mkdir(exist_ok=True)
        (tmp_path / "images" / f"{number}.png").write_bytes(b"")
    missing = CliRunner().invoke(app, [*words, "--force", str(tmp_path / "images")])
    assert missing.exit_code == 1 and "has no inertial sensor; vo info" in missing.stderr
