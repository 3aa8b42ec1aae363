"""Threads and processes of a run: the same results, nothing left behind; its profile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vo.base.config import load_config
from vo.base.types import Estimate
from vo.runs.run_recording import run

FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")


def _run(source: Path, output: Path, threads: int) -> list[bytes]:
    run(source, output, config=load_config("fast", [f"threads={threads}"]))
    return [(output / name).read_bytes() for name in FILES]


def test_any_number_of_threads_writes_the_same_bytes(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    alone = _run(synthetic_stereo, tmp_path / "1", 1)
    assert _run(synthetic_stereo, tmp_path / "2", 2) == alone
    assert _run(synthetic_stereo, tmp_path / "4", 4) == alone


def test_a_busy_machine_makes_no_difference(synthetic_stereo: Path, tmp_path: Path) -> None:
    alone = _run(synthetic_stereo, tmp_path / "1", 1)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    try:
        assert _run(synthetic_stereo, tmp_path / "2", 2) == alone
    finally:
        for process in busy:
            process.kill()
            process.wait()


class Impatient:
    """Presses Ctrl-C during the tenth frame."""

    def begin(self, name: str, total: int) -> None: ...

    def step(self, done: int, estimate: Estimate) -> None:
        if done == 10:
            signal.raise_signal(signal.SIGINT)

    def finish(self) -> None: ...


def test_an_interrupted_run_has_its_last_window_smoothed(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    files = []
    for threads in (1, 2):
        output = tmp_path / str(threads)
        config = load_config("fast", [f"threads={threads}"])
        with pytest.raises(KeyboardInterrupt):
            run(synthetic_stereo, output, config=config, progress=Impatient())
        files.append([(output / name).read_bytes() for name in FILES])
    assert files[0] == files[1]


def test_ctrl_c_in_a_terminal_leaves_no_process_and_no_traceback(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    script = "import sys; from vo.cli.app import app; sys.argv[0] = 'vo'; app()"
    command = [sys.executable, "-c", script, "run", str(synthetic_stereo), "-o", str(tmp_path)]
    running = subprocess.Popen(
        [*command, "--threads", "2"], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert running.stderr is not None
    while not (tmp_path / "causal.tum.partial").exists():
        assert running.poll() is None
        time.sleep(0.01)
    children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
    found = [int(pid) for pid in children.read_text().split()] if children.exists() else []
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to the whole group
    _, told = running.communicate(timeout=30)
    assert running.returncode == 130
    assert "Traceback" not in told
    for pid in found:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_the_profile_s_stages_sum_to_the_wall_time(synthetic_stereo: Path, tmp_path: Path) -> None:
    config = load_config("fast")
    since = time.perf_counter()
    summary = run(synthetic_stereo, tmp_path, config=config, profile_since=since)
    wall_ms = (time.perf_counter() - since) * 1e3
    told = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["profile"]
    assert summary.profile is not None and told == summary.profile._asdict()
    assert sum(told["stages_ms"].values()) == pytest.approx(told["wall_ms"], abs=0.01)
    assert 0.8 * wall_ms < told["wall_ms"] <= wall_ms
    assert {"start-up", "read", "features", "align", "window", "smooth"} < set(told["stages_ms"])
    assert 0.0 <= told["stages_ms"]["other"] < 0.2 * told["wall_ms"]


def test_without_being_asked_there_is_no_profile(synthetic_stereo: Path, tmp_path: Path) -> None:
    run(synthetic_stereo, tmp_path, config=load_config("fast"), end=2)
    assert "profile" not in json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
