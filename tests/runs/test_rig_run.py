"""`vo run` on recordings of several cameras."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import vo
from vo.recordings.sources.registry import open_source


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds in a room with a pair and two cameras that look to the rear."""
    path = tmp_path_factory.mktemp("robot") / "robot"
    return _render(path, "robot", "none,stagger=0.5", 0.6)


@pytest.fixture(scope="module")
def dark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds, of which all cameras are dark for a quarter."""
    path = tmp_path_factory.mktemp("dark") / "dark"
    return _render(path, "robot", "none,blackout=10", 0.4, "seconds=5", "fps=8")


def _render(path: Path, rig: str, effects: str, scale: float, *more: str) -> Path:
    settings = ["world=room", "motion=handheld", "seconds=2", "fps=10", "seed=3", f"scale={scale}"]
    settings += more
    return vo.synth(path, camera=rig, effects=effects, overrides=settings)


def test_all_cameras_are_used_and_have_their_poses(robot: Path, tmp_path: Path) -> None:
    summary = vo.run(robot, tmp_path / "out")
    assert summary.facts.mode == "rig" and summary.tracked == 20
    assert vo.evaluate(tmp_path / "out", robot).ate.translation.rmse < 0.005
    unused = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["inertial"]
    assert unused["reason"] == "the images of the rig have different times"
    with (tmp_path / "out" / "cameras.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["camera"] for row in rows[:5]] == ["cam0", "cam1", "cam2", "cam3", "body"]
    # The last camera is 20 ms late.
    assert int(rows[3]["stamp_ns"]) - int(rows[0]["stamp_ns"]) == 20_000_000
    rig = open_source(robot).rig
    apart = [np.array([float(rows[i][axis]) for axis in ("tx", "ty", "tz")]) for i in (0, 1)]
    distance = np.linalg.norm(rig.cam0_from_cams[1, :3, 3])
    assert np.linalg.norm(apart[1] - apart[0]) == pytest.approx(distance, abs=0.03)


def test_a_sensor_gives_metres_where_cameras_see_nothing_in_common(tmp_path: Path) -> None:
    path = _render(tmp_path / "drone", "drone", "none", 0.6, "seconds=6", "fps=8")
    summary = vo.run(path, tmp_path / "out")
    assert summary.inertial is not None and summary.inertial.states is not None
    assert summary.inertial.metric_worlds == (0,)
    found = vo.evaluate(tmp_path / "out", path)
    assert found.alignment.kind == "se3"
    assert abs(found.alignment.scale_error_percent) < 2.0
    assert found.ate.translation.rmse < 0.02


def test_a_sensor_and_one_camera_give_metres_where_cameras_differ_in_stamps(tmp_path: Path) -> None:
    path = _render(tmp_path / "drone", "drone", "none,stagger=1", 0.5)
    assert vo.run(path, tmp_path / "one").facts.mode == "mono"
    found = json.loads((tmp_path / "one" / "summary.json").read_text("utf-8"))["warnings"]
    assert any("see nothing in common, at different times; only cam0" in text for text in found)
    alone = vo.run(path, tmp_path / "both", imu=False)
    assert alone.facts.mode != "mono" and alone.tracked > 15


def test_a_sensor_leads_through_darkness_of_all_cameras(dark: Path, tmp_path: Path) -> None:
    alone = vo.run(dark, tmp_path / "alone", imu=False)
    assert alone.lost == 10 and len(alone.segments) == 2
    summary = vo.run(dark, tmp_path / "out")
    assert summary.lost == 0 and len(summary.segments) == 1
    assert len((tmp_path / "out" / "trajectory.tum").read_text("utf-8").splitlines()) == 40
    assert vo.evaluate(tmp_path / "out", dark).ate.translation.rmse < 0.01


def test_a_sensor_with_wrong_axes_changes_no_byte(dark: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(dark, copy)
    file = copy / "mav0" / "imu0" / "data.csv"
    heading, *rows = file.read_text("utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    turned = [",".join(c[n] for n in (0, 2, 1, 3, 5, 4, 6)) for c in cells]
    file.write_text("\n".join([heading, *turned, ""]), encoding="utf-8")
    summary = vo.run(copy, tmp_path / "out")
    assert summary.inertial is not None and summary.inertial.is_contradiction
    vo.run(copy, tmp_path / "alone", imu=False)
    for name in ("trajectory.tum", "causal.tum", "covariance.csv", "cameras.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def test_missing_images_of_any_camera_are_said(robot: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(robot, copy)
    for number in (2, 3):
        for image in sorted((copy / "mav0" / f"cam{number}" / "data").iterdir())[12 + number :]:
            image.unlink()
    summary = vo.run(copy, tmp_path / "out")
    assert summary.tracked == 20 and summary.unpaired == 6
    told = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["warnings"]
    assert "6 frames used without the image of a camera" in told
    assert any(
        text.startswith("images of cam2, cam3 are missing, covered, dark or frozen, up to 2 at a")
        for text in told
    )
    assert vo.evaluate(tmp_path / "out", robot).ate.translation.rmse < 0.005


def test_frames_that_camera_0_lacks_are_in_all_outputs(robot: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(robot, copy)
    table = copy / "mav0" / "cam0" / "data.csv"
    lines = table.read_text("utf-8").splitlines()
    table.write_text("\n".join(lines[:9] + lines[16:]), encoding="utf-8")
    summary = vo.run(copy, tmp_path / "out", colmap=tmp_path / "colmap")
    assert (summary.frames, summary.tracked, summary.unpaired) == (20, 20, 7)
    assert vo.evaluate(tmp_path / "out", robot).ate.translation.rmse < 0.005
    stamps = open_source(robot).stamps_ns.tolist()
    for name in ("poses.csv", "frames.csv", "cameras.csv"):
        with (tmp_path / "out" / name).open() as file:
            numbers = [int(row["frame"]) for row in csv.DictReader(file)]
        assert sorted(set(numbers)) == list(range(20)), name
    times = np.loadtxt(tmp_path / "out" / "trajectory.tum")[:, 0]
    np.testing.assert_allclose(times, 1e-9 * np.array(stamps), atol=1e-6)
    # What works with the images of camera 0 leaves those frames out.
    vo.report(tmp_path / "out", tmp_path / "report.html")
    assert vo.convert(copy, tmp_path / "a.mcap", to="mcap") == tmp_path / "a.mcap"
    frames = list(open_source(tmp_path / "a.mcap").frames())
    missing = [frame.index for frame in frames if frame.images[0] is None]
    assert [len(frames), missing] == [20, list(range(8, 15))]


def test_a_rig_is_found_in_the_map_of_an_earlier_run(robot: Path, tmp_path: Path) -> None:
    file = tmp_path / "room.vomap"
    vo.run(robot, tmp_path / "first", save_map=file)
    summary = vo.run(robot, tmp_path / "second", map=file)
    assert summary.map is not None and summary.map.met == (0,)
    assert vo.evaluate(tmp_path / "second", robot).ate.translation.rmse < 0.01
