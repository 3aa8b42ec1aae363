"""Ctrl-C while a frame is in hand."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from vo.base.config import load_config
from vo.base.types import Estimate, Frame
from vo.outputs.recorders.exports import Exports
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FAST = load_config("fast")


class Impatient:
    """Presses Ctrl-C during the third frame, some times in a row."""

    def __init__(self, times: int) -> None:
        self.times = times
        self.survived = 0

    def begin(self, name: str, total: int) -> None: ...

    def step(self, done: int, estimate: Estimate) -> None:
        for _ in range(self.times if done == 3 else 0):
            signal.raise_signal(signal.SIGINT)
            self.survived += 1

    def finish(self) -> None: ...


def test_one_ctrl_c_waits_for_the_frame_in_hand(synthetic_stereo: Path, tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    watcher = Impatient(1)
    with pytest.raises(KeyboardInterrupt):
        run(synthetic_stereo, tmp_path, config=FAST, progress=watcher)
    assert watcher.survived == 1
    assert signal.getsignal(signal.SIGINT) is before
    assert len(read_tum(tmp_path / "trajectory.tum")) == 3
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (summary["status"], summary["frames"]) == ("interrupted", 3)


def test_a_second_ctrl_c_while_a_frame_is_written_costs_nothing(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    watcher = Impatient(2)
    with pytest.raises(KeyboardInterrupt):
        run(synthetic_stereo, tmp_path, config=FAST, progress=watcher)
    assert watcher.survived == 2
    assert len(read_tum(tmp_path / "trajectory.tum")) == 3


class SlowSource:
    """A recording during whose fourth image Ctrl-C is pressed twice."""

    def __init__(self, source: Any) -> None:
        self._source = source
        self.survived = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def __len__(self) -> int:
        return len(self._source)

    def frames(self, *args: Any, **options: Any) -> Iterator[Frame]:
        for frame in self._source.frames(*args, **options):
            if frame.index == 3:
                for _ in range(2):
                    signal.raise_signal(signal.SIGINT)
                    self.survived += 1
            yield frame


def test_a_second_ctrl_c_during_a_frame_does_not_wait(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    source = SlowSource(open_source(synthetic_stereo))
    with pytest.raises(KeyboardInterrupt):
        run(source, tmp_path, config=FAST)
    assert source.survived == 1
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["status"] == "interrupted"
    assert len(read_tum(tmp_path / "trajectory.tum")) == summary["frames"] >= 2


class AtTheEnd(Impatient):
    """Presses it in the last frame, and some times while the results are saved."""

    def step(self, done: int, estimate: Estimate) -> None:
        if estimate.frame_index == 4:
            signal.raise_signal(signal.SIGINT)

    def finish(self) -> None:
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)


def test_ctrl_c_after_the_last_frame_does_not_undo_the_run(
    synthetic_stereo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    exports = Exports(tmp_path / "a.mcap", tmp_path / "colmap", tmp_path / "a.ply")
    out = tmp_path / "out"
    summary = run(synthetic_stereo, out, config=FAST, end=5, exports=exports, progress=AtTheEnd(0))
    assert summary.status == "finished"
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["status"] == "finished"
    assert len(read_tum(out / "trajectory.tum")) == 5
    assert (tmp_path / "colmap" / "sparse" / "0" / "points3D.txt").is_file()
    assert b"element vertex 0\n" not in (tmp_path / "a.ply").read_bytes()[:400]
    assert (tmp_path / "a.mcap").read_bytes().endswith(b"\x89MCAP0\r\n")
    assert caplog.messages == ["the results are being saved, which cannot be interrupted"]


class MoreImpatient(Impatient):
    """Presses it once more while the results are saved."""

    def finish(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_ctrl_c_while_results_are_saved_costs_none(synthetic_stereo: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(synthetic_stereo, tmp_path, config=FAST, progress=MoreImpatient(1))
    assert len(read_tum(tmp_path / "trajectory.tum")) == 3
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (summary["status"], summary["tracked"]) == ("interrupted", 3)


def test_outside_the_main_thread_signals_are_left_alone(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    tracked: list[int] = []

    def work() -> None:
        tracked.append(run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert tracked == [2]
