"""`vo run` starts the optimizer's process before loading anything else, and always ends it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

VO = Path(sys.executable).with_name("vo")
HEAVY = {"cv2", "gtsam", "numba", "numpy"}

# Loaded by Python at start-up, also in the optimizer: records all processes, and the modules loaded
# when a process is started.
NOTES = """
import os, sys
from pathlib import Path

def note(event, arguments):
    if event == "subprocess.Popen":
        with (Path(__file__).parent / "started").open("a") as file:
            print(*sys.modules, file=file)

sys.addaudithook(note)
(Path(__file__).parent / f"{os.getpid()}.pid").touch()
"""
# Waits, before the odometry is loaded, until the optimizer's process has recorded itself.
WAIT = """
import time

class Waiter:
    def find_spec(self, name, path=None, target=None):
        if name == "vo.runs.run_recording":
            sys.meta_path.remove(self)
            until = time.monotonic() + 30
            while len(list(Path(__file__).parent.glob("*.pid"))) < 2 and time.monotonic() < until:
                time.sleep(0.01)
            {then}

sys.meta_path.insert(0, Waiter())
"""


def run(folder: Path, source: Path, *words: str, more: str = "") -> tuple[int, str]:
    """Exit status and standard error of a run."""
    (folder / "sitecustomize.py").write_text(NOTES + more, encoding="utf-8")
    command = [VO, "run", source, "-o", folder / "out", *words]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    return done.returncode, done.stderr


def modules_at_starts(folder: Path) -> list[set[str]]:
    """Modules loaded at each start of a process."""
    file = folder / "started"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [set(line.split()) for line in lines]


def processes(folder: Path) -> list[int]:
    return [int(path.stem) for path in folder.glob("*.pid")]


def assert_all_ended(folder: Path, count: int) -> None:
    pids = processes(folder)
    assert len(pids) == count
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_it_is_started_once_and_before_heavy_modules(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    assert run(tmp_path, synthetic_stereo, "--threads", "2", "--end", "4")[0] == 0
    (loaded,) = modules_at_starts(tmp_path)
    assert not HEAVY & loaded
    assert_all_ended(tmp_path, 2)


def test_none_is_started_with_one_thread(synthetic_stereo: Path, tmp_path: Path) -> None:
    assert run(tmp_path, synthetic_stereo, "--set", "threads=1", "--end", "4")[0] == 0
    assert not modules_at_starts(tmp_path)
    assert_all_ended(tmp_path, 1)


def test_none_is_started_with_an_invalid_setting(tmp_path: Path) -> None:
    assert run(tmp_path, tmp_path, "--set", "thread=2")[0] == 1
    assert_all_ended(tmp_path, 1)


@pytest.mark.parametrize(
    ("source", "then", "status"),
    [("missing", "pass", 1), ("", "pass", 1), ("missing", "os.kill(os.getpid(), 2)", 130)],
    ids=["no recording", "no images", "ctrl-c"],
)
def test_it_ends_with_a_run_that_fails(tmp_path: Path, source: str, then: str, status: int) -> None:
    more = WAIT.format(then=then)
    assert run(tmp_path, tmp_path / source, "--threads", "2", more=more)[0] == status
    assert_all_ended(tmp_path, 2)


def test_a_failed_start_is_only_a_warning(synthetic_stereo: Path, tmp_path: Path) -> None:
    more = 'sys.executable = "/nowhere/python"'
    status, errors = run(
        tmp_path, synthetic_stereo, "--threads", "2", "--end", "4", "-q", more=more
    )
    assert status == 0
    assert errors.startswith("warning: optimising in this process, no other can be started")
    assert len(modules_at_starts(tmp_path)) == 2
    assert_all_ended(tmp_path, 1)


def test_an_old_name_of_a_setting_gets_one_warning_line(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    words = ("--set", "mapping.look_back=3", "--end", "2", "--quiet")
    status, errors = run(tmp_path, synthetic_stereo, *words)
    renamed = "mapping.look_back is now mapping.fuse_keyframes"
    assert (status, errors) == (0, f"warning: settings in default have been renamed: {renamed}\n")
