"""Ctrl-C while a frame is in hand."""

from __future__ import annotations

import json
import signal
import threading
from pathlib import Path

import pytest

from vo.config import load_config
from vo.formats.trajectory import read_tum
from vo.run import run
from vo.types import Estimate

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


def test_a_second_ctrl_c_does_not_wait(synthetic_stereo: Path, tmp_path: Path) -> None:
    watcher = Impatient(2)
    with pytest.raises(KeyboardInterrupt):
        run(synthetic_stereo, tmp_path, config=FAST, progress=watcher)
    assert watcher.survived == 1
    assert len(read_tum(tmp_path / "trajectory.tum")) == 3


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
