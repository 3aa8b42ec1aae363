"""Rounds of one camera with an inertial sensor, with loops closed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from room_course import FILES, run_rounds

from vo.base.geometry.similarity import umeyama
from vo.engine.maps.map_file import MapFile
from vo.recordings.formats.trajectory import read_tum

IMU = "inertial.enabled=true"
LOOPS = "memory.loops=true"


@pytest.fixture(scope="module")
def plain(rounds: Path) -> Path:
    """Results without loops."""
    run_rounds(rounds, rounds.parent / "imu_plain", IMU, "memory.loops=false")
    return rounds.parent / "imu_plain"


@pytest.fixture(scope="module")
def closed(rounds: Path) -> Path:
    """Results with loops; `imu.map` is in the folder beside."""
    saved = rounds.parent / "imu.map"
    run_rounds(rounds, rounds.parent / "imu_closed", IMU, LOOPS, "threads=4", save_map=saved)
    return rounds.parent / "imu_closed"


def _summary(folder: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return summary


def _errors(folder: Path, recording: Path) -> tuple[float, float, float]:
    """Position error in metres (RMS, aligned rigidly), scale error, largest tilt in degrees."""
    found, truth = read_tum(folder / "trajectory.tum"), read_tum(recording / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, found.stamps_ns - 1000)
    true = truth.positions[rows]
    aligned = umeyama(found.positions, true, with_scale=False).transform_points(found.positions)
    error = float(np.sqrt(np.mean(np.sum((aligned - true) ** 2, axis=1))))
    scale = umeyama(found.positions, true, with_scale=True).scale
    turned = found.world_from_cam[:, :3, :3] @ np.swapaxes(truth.world_from_cam[rows, :3, :3], 1, 2)
    tilt = np.degrees(np.arccos(np.clip(turned[:, 2, 2], -1.0, 1.0)))
    return error, abs(1.0 / scale - 1.0), float(tilt.max())


def test_a_path_with_loops_is_metric_upright_and_more_accurate(
    rounds: Path, plain: Path, closed: Path
) -> None:
    summary = _summary(closed)
    assert len(summary["loops"]) >= 5 and {loop["kind"] for loop in summary["loops"]} == {"loop"}
    assert summary["length_unit"] == "m" and summary["inertial"]["metric_worlds"] == [0]
    error, scale, tilt = _errors(closed, rounds)
    assert scale < 0.01 and tilt < 0.5
    assert error < 0.95 * _errors(plain, rounds)[0]
    up = np.array(summary["inertial"]["states"]["up"])
    assert np.degrees(np.arccos(up[2])) < 0.3
    first = read_tum(closed / "trajectory.tum").world_from_cam[0]
    np.testing.assert_allclose(first[:3, 3], 0.0, atol=0.01)
    assert first[0, 2] > 0.5 and abs(first[1, 2]) < 0.01  # looks along x


def test_the_path_before_loops_is_that_of_a_run_without_them(plain: Path, closed: Path) -> None:
    before, without = read_tum(closed / "odometry.tum"), read_tum(plain / "trajectory.tum")
    np.testing.assert_array_equal(before.stamps_ns, without.stamps_ns)
    np.testing.assert_allclose(before.world_from_cam, without.world_from_cam, atol=1e-9)


def test_the_saved_map_is_in_the_world_of_the_path(rounds: Path, closed: Path) -> None:
    path = read_tum(closed / "trajectory.tum")
    with MapFile(rounds.parent / "imu.map") as saved:
        assert len(saved.keys) > 20
        for key, pose in zip(saved.placed.keys, saved.placed.world_from_cam, strict=True):
            row = np.searchsorted(path.stamps_ns, saved.place(key).frame.stamp_ns)
            np.testing.assert_allclose(pose, path.world_from_cam[row], atol=1e-6)


def test_one_thread_gives_the_same_bytes(rounds: Path, closed: Path, tmp_path: Path) -> None:
    run_rounds(rounds, tmp_path / "out", IMU, LOOPS, "threads=1")
    for name in (*FILES, "odometry.tum"):
        assert (tmp_path / "out" / name).read_bytes() == (closed / name).read_bytes(), name


def test_without_a_place_seen_again_the_results_have_the_same_bytes(
    rounds: Path, tmp_path: Path
) -> None:
    for name, settings in (("off", [IMU, "memory.loops=false"]), ("on", [IMU, LOOPS])):
        summary = run_rounds(rounds, tmp_path / name, *settings, end=60)
        assert summary["loops"] == [] and summary["length_unit"] == "m"
    for name in FILES:
        assert (tmp_path / "on" / name).read_bytes() == (tmp_path / "off" / name).read_bytes()


@pytest.mark.parametrize(("first", "last"), [(22, 124), (62, 118)])
def test_segments_that_are_merged_have_one_scale_and_one_vertical(
    first: int, last: int, rounds: Path, tmp_path: Path
) -> None:
    """The lens is covered for 5.6 s, or from before the first states to the second round."""
    recording = tmp_path / "room"
    shutil.copytree(rounds, recording)
    for image in sorted((recording / "mav0/cam0/data").glob("*.png"))[first:last]:
        size = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE).shape
        cv2.imwrite(str(image), np.zeros(size, np.uint8))
    summary = run_rounds(recording, tmp_path / "out", IMU, LOOPS)
    assert "merge" in {loop["kind"] for loop in summary["loops"]}
    assert [s["segment"] for s in summary["segments"]] == [0] and summary["length_unit"] == "m"
    error, scale, tilt = _errors(tmp_path / "out", rounds)
    assert error < 0.02 and scale < 0.02 and tilt < 0.5


@pytest.mark.parametrize("settings", [(), (IMU,)])
def test_a_later_session_is_in_the_metres_of_the_map(
    settings: tuple[str, ...], rounds: Path, closed: Path, tmp_path: Path
) -> None:
    """Also without an inertial sensor of its own."""
    saved = rounds.parent / "imu.map"
    with MapFile(saved) as file:
        assert file.header.metric_worlds == (0,)
    again = f"memory.map={saved}"
    summary = run_rounds(
        rounds, tmp_path / "out", LOOPS, again, *settings, end=80, save_map=tmp_path / "both.map"
    )
    assert summary["map"]["met"] == [0] == summary["map"]["metric_worlds"]
    assert summary["length_unit"] == "m"
    first, second = (read_tum(f / "trajectory.tum") for f in (closed, tmp_path / "out"))
    apart = second.positions - first.positions[: len(second.positions)]
    assert np.median(np.linalg.norm(apart, axis=1)) < 0.02
    with MapFile(tmp_path / "both.map") as file:
        assert file.header.metric_worlds == (0,)
