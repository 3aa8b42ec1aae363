"""Runs around a room and back, with loops closed."""

from __future__ import annotations

import json
import math
import re
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from room_course import END, FILES, ate, run_rounds
from rrd import read_rrd
from typer.testing import CliRunner

from vo.base.config import load_config
from vo.base.errors import ConfigError
from vo.base.types import Floats
from vo.cli.app import app
from vo.engine.maps.map_file import MapFile
from vo.engine.odometry import Odometry
from vo.engine.places.database import KeyframeDatabase
from vo.outputs.recorders import entities
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.run_options import RunOptions
from vo.runs.run_recording import _with_loops


@pytest.fixture(scope="module")
def plain(rounds: Path) -> Path:
    """Results without loops."""
    run_rounds(rounds, rounds.parent / "plain", "memory.loops=false")
    return rounds.parent / "plain"


def _loops(folder: Path) -> list[dict[str, Any]]:
    loops: list[dict[str, Any]] = json.loads((folder / "summary.json").read_text())["loops"]
    return loops


def _true_positions(recording: Path) -> Floats:
    return read_tum(recording / "groundtruth.tum").positions


def test_every_loop_is_true_and_the_error_of_the_path_gets_smaller(
    rounds: Path, plain: Path, closed: Path
) -> None:
    loops, positions = _loops(closed), _true_positions(rounds)
    assert len(loops) >= 5
    for loop in loops:
        apart = positions[loop["frame"]] - positions[loop["earlier_frame"]]
        assert np.linalg.norm(apart) < 2.0
        assert loop["frame"] - loop["earlier_frame"] > 100
        assert loop["kind"] == "loop" and loop["inliers"] >= 25
        assert math.isfinite(loop["correction_m"]) and math.isfinite(loop["correction_deg"])
    assert ate(closed, rounds) < 0.9 * ate(plain, rounds)


def test_causal_poses_are_the_same_until_the_first_corrected_frame(
    plain: Path, closed: Path
) -> None:
    marked = {loop["corrected_from"] for loop in _loops(closed)} - {None}
    assert marked
    before, after = (read_tum(folder / "causal.tum") for folder in (plain, closed))
    np.testing.assert_array_equal(before.stamps_ns, after.stamps_ns)
    changed = np.abs(before.world_from_cam - after.world_from_cam).max(axis=(1, 2)) > 1e-9
    first = int(np.flatnonzero(changed)[0])
    rows = np.loadtxt(closed / "frames.csv", delimiter=",", skiprows=1, usecols=(1, 0), dtype=int)
    frame_of = dict(rows.tolist())
    assert frame_of[int(after.stamps_ns[first])] == min(marked)
    assert changed[first:].all()


def test_the_saved_map_has_the_keyframes_where_the_path_has_them(
    rounds: Path, closed: Path
) -> None:
    path = read_tum(closed / "trajectory.tum")
    with closing(MapFile(rounds.parent / "room.map")) as saved:
        assert len(saved.keys) > 20
        assert len(saved.loops) == len(_loops(closed))
        for key, pose in zip(saved.placed.keys, saved.placed.world_from_cam, strict=True):
            row = np.searchsorted(path.stamps_ns, saved.place(key).frame.stamp_ns)
            np.testing.assert_allclose(pose, path.world_from_cam[row], atol=1e-6)


def test_a_map_is_not_saved_without_loops(rounds: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="leave out `memory.loops=false`"):
        run_rounds(rounds, tmp_path / "out", "memory.loops=false", save_map=tmp_path / "a.map")
    assert not (tmp_path / "out").exists()


def test_the_report_lists_the_loops(closed: Path) -> None:
    done = CliRunner().invoke(app, ["report", str(closed), "--output", str(closed / "a.html")])
    assert done.exit_code == 0, done.output
    page = (closed / "a.html").read_text(encoding="utf-8")
    for loop in _loops(closed):
        assert f'<th scope="row">{loop["frame"]}</th><td>{loop["earlier_frame"]}</td>' in page
    before = re.search(r'"before":\[([^]]*)\]', page)  # the path, drawn with the loops
    assert before is not None and len(before[1].split(",")) > 3 * len(_loops(closed))


def test_the_recording_draws_each_loop_where_its_keyframes_are(rounds: Path, closed: Path) -> None:
    path, truth = read_tum(closed / "trajectory.tum"), read_tum(rounds / "groundtruth.tum")
    strips = read_rrd(rounds.parent / "room.rrd", "strips")
    lines = strips[entities.LOOPS]
    expected: dict[int, list[Floats]] = {}
    for loop in _loops(closed):
        stamps = truth.stamps_ns[[loop["frame"], loop["earlier_frame"]]]
        ends = path.positions[np.searchsorted(path.stamps_ns, stamps)]
        expected.setdefault(loop["corrected_from"] or END - 1, []).append(ends)
    assert [frame for frame, _ in lines] == sorted(expected)
    for frame, found in lines:
        np.testing.assert_allclose(found, expected[frame], atol=1e-5)
    assert len(strips[entities.ODOMETRY_PATH]) == 1
    texts = read_rrd(rounds.parent / "room.rrd", "text")[entities.EVENTS]
    assert sum("sees the place of frame" in str(text) for _, text in texts) == len(_loops(closed))


def test_the_path_before_loops_is_that_of_a_run_without_them(plain: Path, closed: Path) -> None:
    before = read_tum(closed / "odometry.tum")
    without = read_tum(plain / "trajectory.tum")
    np.testing.assert_array_equal(before.stamps_ns, without.stamps_ns)
    np.testing.assert_array_equal(before.world_from_cam, without.world_from_cam)
    assert not (plain / "odometry.tum").exists()


def test_a_single_thread_and_the_default_where_features_allow_loops_give_the_same_bytes(
    rounds: Path, closed: Path, tmp_path: Path
) -> None:
    run_rounds(rounds, tmp_path / "default", "threads=1")
    for name in FILES:
        assert (tmp_path / "default" / name).read_bytes() == (closed / name).read_bytes()
    assert _loops(tmp_path / "default") == _loops(closed)
    summary = run_rounds(rounds, tmp_path / "fast", "features.detector=sift", end=20)
    assert summary["loops"] == []
    with pytest.raises(ConfigError, match="binary descriptors"):
        run_rounds(rounds, tmp_path / "no", "features.detector=sift", "memory.loops=true", end=20)


def test_a_full_disk_ends_the_search_for_loops_and_not_the_run(
    rounds: Path, plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = partial(KeyframeDatabase, memory_bytes=0, folder=tmp_path / "missing")
    monkeypatch.setattr("vo.engine.memory.memory_creation.KeyframeDatabase", full)
    summary = run_rounds(rounds, tmp_path / "out")
    assert (summary["status"], summary["loops"]) == ("finished", [])
    path = (tmp_path / "out" / "trajectory.tum").read_bytes()
    assert path == (plain / "trajectory.tum").read_bytes()


def test_without_a_place_seen_again_the_results_have_the_same_bytes(
    rounds: Path, tmp_path: Path
) -> None:
    for name, setting in (("off", "false"), ("on", "true")):
        summary = run_rounds(rounds, tmp_path / name, f"memory.loops={setting}", end=60)
        assert summary["loops"] == []
    for name in FILES:
        assert (tmp_path / "on" / name).read_bytes() == (tmp_path / "off" / name).read_bytes()


def test_loops_of_frames_that_are_tracked_anew_are_forgotten(rounds: Path) -> None:
    """As where content that is fixed in the image is found late; a graph is optimised meanwhile."""
    config = load_config("default", ["memory.loops=true"])
    source = open_source(rounds, mode="mono")
    with closing(Odometry(source.rig, config)) as odometry:
        for _ in odometry.track_all(source.frames(0, END)):
            pass
        first = odometry.map_alignment.closed_loops[0].frame + 1
        odometry._map.clear_corrected()
        odometry.trajectory.remove_from(first)
        odometry.map_alignment.forget_from(first)
        odometry.map_alignment.finish(odometry._map)
        assert [loop.frame for loop in odometry.map_alignment.closed_loops] == [first - 1]


@pytest.mark.parametrize(
    ("settings", "has_loops"),
    [([], True), (["features.descriptor=rbrief"], True), (["features.descriptor=sift"], False)],
)
def test_loops_are_closed_by_default_with_orb_however_it_is_named(
    settings: list[str], has_loops: bool
) -> None:
    config = load_config(overrides=settings)
    assert _with_loops(config, RunOptions(), is_live=False).memory.loops is has_loops
    assert _with_loops(config, RunOptions(), is_live=True).memory.loops is False
