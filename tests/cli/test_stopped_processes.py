"""What real processes of `vo run` leave when they are stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kills_checks import check, colmap_images, mcap_poses, ply_points, processes_with, rrd_frames

VO = Path(sys.executable).with_name("vo")
# A run whose progress waits after a frame, so that the test can stop it there.
WAITING = """
import signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it would be ignored
from pathlib import Path
from vo.cli.entry import main
from vo.cli.progress import LineProgress
step = LineProgress.step
def waiting(self, done, estimate):
    step(self, done, estimate)
    if done == 12:
        folder = Path(sys.argv[-1]).parent
        folder.joinpath("waiting").touch()
        while not folder.joinpath("go").exists():
            time.sleep(0.01)
LineProgress.step = waiting
main()
"""


def start(recording: Path, folder: Path, mark: str, *, waits: bool) -> subprocess.Popen[str]:
    program = [sys.executable, "-c", WAITING] if waits else [str(VO)]
    command = [*program, "run", str(recording), "-o", str(folder / "out"), "--config", "fast"]
    command += ["--rrd", str(folder / "run.rrd"), "--mcap", str(folder / "run.mcap")]
    command += ["--colmap", str(folder / "model"), "--threads", "2"]
    command += ["--ply", str(folder / "map.ply")]
    return subprocess.Popen(
        command,
        env={**os.environ, "VO_TEST": mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    while not path.exists():
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.002)


def wait_until_gone(mark: str) -> None:
    give_up = time.monotonic() + 60.0
    while processes_with(mark):
        assert time.monotonic() < give_up, "a process is left"
        time.sleep(0.05)


def test_a_killed_run_leaves_its_recordings_and_no_process(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    mark = f"killed-{tmp_path}"
    process = start(synthetic_stereo, tmp_path, mark, waits=True)
    wait_for(tmp_path / "waiting", process)
    assert len(processes_with(mark)) == 1
    time.sleep(2.0)  # longer than the second that may be lost
    process.kill()
    process.communicate()
    wait_until_gone(mark)
    assert mcap_poses(tmp_path / "run.mcap") == 12
    assert rrd_frames(tmp_path / "run.rrd") == 12
    assert ply_points(tmp_path / "map.ply") >= 0
    assert colmap_images(tmp_path / "model") >= 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_run_completes_its_exports(
    number: signal.Signals, synthetic_stereo: Path, tmp_path: Path
) -> None:
    mark = f"stopped-{tmp_path}"
    process = start(synthetic_stereo, tmp_path, mark, waits=True)
    wait_for(tmp_path / "waiting", process)
    process.send_signal(number)
    (tmp_path / "go").touch()
    errors = process.communicate()[1]
    assert process.returncode == 128 + number
    assert f"interrupted; the results so far are in {tmp_path / 'out'}" in " ".join(errors.split())
    rest = check(tmp_path, False, 0.0)
    assert (rest.status, rest.frames, rest.problems) == ("interrupted", 12, [])
    wait_until_gone(mark)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_while_a_run_is_closing_change_nothing(
    number: signal.Signals, synthetic_stereo: Path, tmp_path: Path
) -> None:
    process = start(synthetic_stereo, tmp_path, "closing", waits=False)
    wait_for(tmp_path / "out" / "trajectory.tum", process)
    for _ in range(3):
        process.send_signal(number)
        time.sleep(0.02)
    errors = process.communicate()[1]
    assert process.returncode == 0, errors
    assert "interrupted;" not in errors and "Traceback" not in errors
    rest = check(tmp_path, False, 0.0)
    assert (rest.status, rest.frames, rest.problems) == ("finished", 30, [])
