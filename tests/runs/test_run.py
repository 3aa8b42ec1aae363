"""Runs on a small synthetic recording: what is written, and what is left when they end early."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vo.base.config import Config, load_config
from vo.base.errors import OutputError, SourceError
from vo.base.geometry.similarity import umeyama
from vo.base.types import Estimate, Mode, Rig, Trajectory
from vo.engine.frontend.lazy_future import LazyFuture
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.odometry import Odometry
from vo.outputs.recorders.recorder import TakeSnapshot
from vo.outputs.results.summary import Summary
from vo.recordings.formats.calibration.own import write_calibration
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FAST = load_config("fast")
GROWING = {"trajectory.tum", "causal.tum", "poses.csv", "covariance.csv", "frames.csv"}
WHOLE = GROWING | {"summary.json", "config.yaml"}
FRAMES = 8


class Watcher:
    """Counts steps; does something at one of them."""

    def __init__(self, at: int = -1, error: BaseException | None = None) -> None:
        self.calls: list[Any] = []
        self._at, self._error = at, error

    def begin(self, name: str, total: int) -> None:
        self.calls.append((name, total))

    def step(self, done: int, estimate: Estimate) -> None:
        self.calls.append(done)
        if done == self._at and self._error is not None:
            raise self._error

    def finish(self) -> None:
        self.calls.append("finish")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def summary_in(folder: Path) -> dict[str, Any]:
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def test_writes_all_files(synthetic_stereo: Path, tmp_path: Path) -> None:
    summary = run(synthetic_stereo, tmp_path / "new" / "out", config=FAST, end=FRAMES)
    folder = tmp_path / "new" / "out"
    assert names(folder) == WHOLE
    assert summary.status == "finished"
    assert summary_in(folder) == json.loads(json.dumps(summary.to_dict()))
    assert (summary.frames, summary.tracked, summary.lost) == (FRAMES, FRAMES, 0)
    for name in ("trajectory.tum", "causal.tum"):
        assert len(read_tum(folder / name)) == FRAMES
    assert len(lines(folder / "covariance.csv")) == 1 + summary.keyframes
    check_frames(lines(folder / "frames.csv"), summary)
    assert load_config(folder / "config.yaml") == FAST
    assert {"read", "features", "start", "write", "record"} <= set(summary.stages)


def check_frames(rows: list[str], summary: Summary) -> None:
    table = list(csv.DictReader(rows))
    assert [int(row["frame"]) for row in table] == list(range(FRAMES))
    assert {row["state"] for row in table} == {"tracking"}
    assert sum(int(row["keyframe"]) for row in table) == summary.keyframes
    assert np.median([int(row["inliers"]) for row in table]) == summary.median_inliers
    for row in table:
        assert 0 < int(row["inliers"]) <= int(row["matches"]) <= int(row["features"])
        stages = [float(value) for name, value in row.items() if name.endswith("_ms")]
        assert stages[0] == pytest.approx(sum(stages[1:]), abs=0.01)  # the total comes first
    read_ms = np.median([float(row["read_ms"]) for row in table])
    assert read_ms == pytest.approx(summary.stages["read"].median_ms, abs=0.002)


@pytest.mark.parametrize(("mode", "is_trusted"), [("stereo", False), ("mono", True)])
def test_warnings_of_opening_are_in_the_summary(
    synthetic_stereo: Path, tmp_path: Path, mode: Mode, is_trusted: bool
) -> None:
    """A doubtful calibration makes the path one; a baseline does not count for one camera."""
    rig = open_source(synthetic_stereo).rig
    assert rig.cam1_from_cam0 is not None
    apart = rig.cam1_from_cam0.copy()
    apart[:3, 3] *= 200.0
    file = tmp_path / "far.yaml"
    write_calibration(file, replace(rig, cam1_from_cam0=apart))
    summary = run(
        synthetic_stereo, tmp_path / "out", config=FAST, end=FRAMES, calibration=file, mode=mode
    )
    recorded = summary_in(tmp_path / "out")
    assert any("if it is centimetres" in text for text in recorded["warnings"]) != is_trusted
    assert summary.verdict.word == "not to be trusted" or is_trusted
    assert any("baseline" in text for text in summary.closing_warnings) != is_trusted


def test_smoothed_path_is_near_the_truth(synthetic_stereo: Path, tmp_path: Path) -> None:
    run(synthetic_stereo, tmp_path, config=FAST)
    found = read_tum(tmp_path / "trajectory.tum")
    true = read_tum(synthetic_stereo / "groundtruth.tum")
    assert np.array_equal(found.stamps_ns, true.stamps_ns)
    moved = np.linalg.inv(true.world_from_cam[0]) @ true.world_from_cam
    assert np.abs(moved[:, :3, 3] - found.positions).max() < 0.1


def test_the_same_run_twice_gives_the_same_bytes(synthetic_stereo: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        run(synthetic_stereo, tmp_path / name, config=FAST, end=FRAMES)
    for name in ("trajectory.tum", "causal.tum", "covariance.csv", "config.yaml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_start_end_and_stride(synthetic_stereo: Path, tmp_path: Path) -> None:
    watcher = Watcher()
    summary = run(
        synthetic_stereo, tmp_path, config=FAST, start=3, end=12, stride=2, progress=watcher
    )
    true = read_tum(synthetic_stereo / "groundtruth.tum")
    found = read_tum(tmp_path / "trajectory.tum")
    assert np.array_equal(found.stamps_ns, true.stamps_ns[3:12:2])
    assert (summary.frames, summary.facts.requested) == (5, 5)
    assert watcher.calls == [("walk", 5), 1, 2, 3, 4, 5, "finish"]


def test_with_every_third_frame_tracked_the_others_are_interpolated(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    config = load_config("fast", ["tracking.every=3"])
    summary = run(synthetic_stereo, tmp_path, config=config, end=11)
    assert (summary.tracked, summary.interpolated, summary.untracked) == (4, 6, 1)
    assert summary.frames == 11
    (rest,) = summary.without_pose
    assert (rest.first, rest.last, rest.state) == (10, 10, "untracked")
    table = list(csv.DictReader(lines(tmp_path / "poses.csv")))
    assert [int(row["frame"]) for row in table] == list(range(10))
    assert [row["interpolated"] for row in table] == list("0110110110")
    assert sum(int(row["keyframe"]) for row in table) == summary.keyframes
    found = read_tum(tmp_path / "trajectory.tum")
    truth = read_tum(synthetic_stereo / "groundtruth.tum").positions[:10]
    assert [int(row["stamp_ns"]) for row in table] == found.stamps_ns.tolist()
    for row, line in zip(table, lines(tmp_path / "trajectory.tum"), strict=True):
        assert list(row.values())[5:] == line.split()[1:]
    assert len(read_tum(tmp_path / "causal.tum")) == 4
    fit = umeyama(found.positions, truth, with_scale=False)
    assert np.linalg.norm(fit.transform_points(found.positions) - truth, axis=1).max() < 0.01


def test_mono_that_finds_no_start_ends_honestly(synthetic_stereo: Path, tmp_path: Path) -> None:
    summary = run(synthetic_stereo, tmp_path, config=FAST, mode="mono", end=3)
    assert names(tmp_path) == WHOLE
    assert summary.status == "finished"
    assert summary.tracked + summary.starting + summary.lost == 3
    assert summary.length_unit == "map units"
    assert lines(tmp_path / "trajectory.tum") == [] or summary.tracked


def test_ctrl_c_keeps_what_was_computed(synthetic_stereo: Path, tmp_path: Path) -> None:
    watcher = Watcher(4, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(synthetic_stereo, tmp_path, config=FAST, progress=watcher)
    assert names(tmp_path) == WHOLE
    assert len(read_tum(tmp_path / "trajectory.tum")) == 4
    assert len(read_tum(tmp_path / "causal.tum")) == 4
    summary = summary_in(tmp_path)
    assert (summary["status"], summary["frames"], summary["requested"]) == ("interrupted", 4, 30)
    assert watcher.calls[-1] == "finish"


def test_an_error_keeps_what_was_computed(
    synthetic_stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = Odometry._process

    def failing(self: Odometry, pending: LazyFuture[PreprocessedFrame]) -> Estimate:
        if pending.result().index == 3:
            raise ZeroDivisionError("division\nby zero")
        return process(self, pending)

    monkeypatch.setattr(Odometry, "_process", failing)
    with pytest.raises(ZeroDivisionError):
        run(synthetic_stereo, tmp_path, config=FAST)
    assert len(read_tum(tmp_path / "trajectory.tum")) == 3
    summary = summary_in(tmp_path)
    assert (summary["status"], summary["frames"]) == ("failed", 3)
    assert summary["error"] == "ZeroDivisionError: division by zero"


def test_a_killed_run_leaves_every_pose(synthetic_stereo: Path, tmp_path: Path) -> None:
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    run(synthetic_stereo, killed, config=FAST, end=2)  # stale files
    code = (
        "import os, sys; sys.path.insert(0, sys.argv[1])\n"
        "from test_run import *\n"
        "class Killer(Watcher):\n"
        "    def step(self, done, estimate):\n"
        f"        if done == {FRAMES}: os.kill(os.getpid(), signal.SIGKILL)\n"
        "run(sys.argv[2], Path(sys.argv[3]), config=FAST, progress=Killer())\n"
    )
    here = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", code, here, str(synthetic_stereo), str(killed)])
    assert done.returncode == -signal.SIGKILL
    assert names(killed) == {f"{n}.partial" for n in GROWING} | {"summary.json", "config.yaml"}
    assert summary_in(killed)["status"] == "interrupted"
    run(synthetic_stereo, whole, config=FAST, end=FRAMES)
    same = (killed / "causal.tum.partial", whole / "causal.tum")
    assert same[0].read_bytes() == same[1].read_bytes()
    # The optimizer's last results, for which a whole run waits, are not in it yet.
    left, all_ = (
        read_tum(p) for p in (killed / "trajectory.tum.partial", whole / "trajectory.tum")
    )
    np.testing.assert_array_equal(left.stamps_ns, all_.stamps_ns)
    np.testing.assert_allclose(left.world_from_cam, all_.world_from_cam, atol=5e-3)
    lines = [
        [line.split(",")[:3] for line in file.read_text().splitlines()]
        for file in (killed / "covariance.csv.partial", whole / "covariance.csv")
    ]
    assert lines[0] == lines[1][: len(lines[0])]


def test_a_run_that_is_killed_while_it_closes_counts_the_frames_of_its_tables(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    code = (
        "import os, sys; sys.path.insert(0, sys.argv[1])\n"
        "from test_run import *\n"
        "from vo.runs.run_session import RunSession\n"
        "RunSession._save_map = lambda self: os.kill(os.getpid(), signal.SIGKILL)\n"
        "output = Path(sys.argv[3])\n"
        "run(sys.argv[2], output, config=FAST, end=7, save_map=output / 'map.vomap')\n"
    )
    here = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", code, here, str(synthetic_stereo), str(tmp_path)])
    assert done.returncode == -signal.SIGKILL
    summary = summary_in(tmp_path)
    assert (summary["status"], summary["frames"], summary["tracked"]) == ("interrupted", 7, 7)
    assert len(read_tum(tmp_path / "trajectory.tum")) == 7


def test_files_of_an_earlier_run_go_away(synthetic_stereo: Path, tmp_path: Path) -> None:
    for name in (*WHOLE, "causal.tum.partial", "mine.txt"):
        (tmp_path / name).write_text("stale", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        run(synthetic_stereo, tmp_path, config=FAST, progress=Watcher(1, KeyboardInterrupt()))
    assert names(tmp_path) == WHOLE | {"mine.txt"}
    assert all(
        (path.read_text(encoding="utf-8") == "stale") == (path.name == "mine.txt")
        for path in tmp_path.iterdir()
    )


def test_a_run_that_cannot_begin_leaves_the_earlier_one(tmp_path: Path) -> None:
    (tmp_path / "trajectory.tum").write_text("earlier", encoding="utf-8")
    with pytest.raises(SourceError):
        run(tmp_path / "missing", tmp_path, config=FAST)
    assert (tmp_path / "trajectory.tum").read_text(encoding="utf-8") == "earlier"


def test_a_recorder_gets_the_whole_run(synthetic_stereo: Path, tmp_path: Path) -> None:
    calls: list[Any] = []

    class Notes:
        def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
            calls.append((name, rig.is_stereo, ground_truth is not None))

        def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
            calls.append(estimate.frame_index)
            assert snapshot().view.image0.ndim == 2

        def finish(self, causal: Trajectory, smoothed: Trajectory, findings: object) -> None:
            calls.append((len(causal), len(smoothed)))

    run(synthetic_stereo, tmp_path, config=FAST, end=3, recorder=Notes())
    assert calls == [("walk", True, True), 0, 1, 2, (3, 3)]


def test_records_for_rerun(synthetic_stereo: Path, tmp_path: Path) -> None:
    rrd = tmp_path / "folder" / "run.rrd"
    run(synthetic_stereo, tmp_path, config=FAST, end=4, rrd=rrd)
    rerun = Path(sys.executable).with_name("rerun")
    done = subprocess.run([rerun, "rrd", "verify", rrd], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_recording_that_cannot_be_written_is_told_before_any_work(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write the recording"):
        run(synthetic_stereo, tmp_path / "out", config=FAST, rrd=tmp_path / "file" / "run.rrd")
    assert not list((tmp_path / "out").iterdir())


def test_the_summary_is_kept_up_to_date(
    synthetic_stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vo.runs.run_session._REFRESH_S", 0.0)
    monkeypatch.setattr("vo.runs.run_session._REFRESH_RATIO", 1e9)
    seen: list[int] = []

    class Reader(Watcher):
        def step(self, done: int, estimate: Estimate) -> None:
            summary = summary_in(tmp_path)
            assert summary["status"] == "interrupted"
            seen.append(summary["frames"])

    run(synthetic_stereo, tmp_path, config=Config(), end=4, progress=Reader())
    assert seen == [0, 1, 2, 3]


def test_frames_asked_for_that_are_all_damaged(
    synthetic_stereo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = shutil.copytree(synthetic_stereo, tmp_path / "damaged")
    for image in sorted((source / "mav0" / "cam0" / "data").iterdir())[:4]:
        image.write_bytes(b"damaged")
    with pytest.raises(SourceError, match="none of the 4 requested frames can be read; the first"):
        run(source, tmp_path / "out", config=FAST, end=4)
    summary = summary_in(tmp_path / "out")
    assert (summary["status"], len(summary["skipped"])) == ("failed", 4)
    assert summary["without_pose"][0]["state"] == "skipped"
    assert len(caplog.records) == 2  # the first, and that the others are the same
