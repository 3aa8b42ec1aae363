"""A solver in a process of its own."""

from __future__ import annotations

import io
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from windows import drive

from vo.base.config import SmoothingConfig
from vo.engine.backend import launch as child_module
from vo.engine.backend.messages import receive
from vo.engine.backend.process import SolverProcess
from vo.engine.backend.solution import WindowSolution, solve, unsolved
from vo.engine.backend.window_problem import WindowProblem

CONFIG = SmoothingConfig()

WindowProcess: TypeAlias = "SolverProcess[WindowProblem, WindowSolution]"


@pytest.fixture
def optimizer() -> Iterator[WindowProcess]:
    optimizer = _process()
    yield optimizer
    optimizer.close()


def _process() -> WindowProcess:
    return SolverProcess(partial(solve, config=CONFIG), unsolved)


def _problem(seed: int = 1) -> WindowProblem:
    return drive(stereo=True, fixed=1).with_noise(seed).with_guess().problem


def _assert_same(found: WindowSolution, expected: WindowSolution) -> None:
    assert found.converged and expected.converged
    assert found.calibration_residual is not None and expected.calibration_residual is not None
    np.testing.assert_array_equal(
        found.calibration_residual.value, expected.calibration_residual.value
    )
    for name in ("world_from_cam", "information", "points", "point_ok"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def _pid(optimizer: WindowProcess) -> int:
    return optimizer._child.pid


def _has_ended(pid: int) -> bool:
    for _ in range(200):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


def test_the_answer_is_the_same_as_in_this_process(optimizer: WindowProcess) -> None:
    for seed in (1, 2):
        optimizer.submit(_problem(seed))
        _assert_same(optimizer.result(), solve(_problem(seed), CONFIG))


def test_a_killed_process_costs_a_warning_and_nothing_else(
    optimizer: WindowProcess, caplog: pytest.LogCaptureFixture
) -> None:
    expected = solve(_problem(), CONFIG)
    optimizer.submit(_problem())
    _assert_same(optimizer.result(), expected)
    killed = _pid(optimizer)
    os.kill(killed, signal.SIGKILL)
    with caplog.at_level(logging.WARNING):
        optimizer.submit(_problem())
        _assert_same(optimizer.result(), expected)
    (record,) = caplog.records
    assert "died (status -9)" in record.getMessage()
    assert _pid(optimizer) != killed
    caplog.clear()
    optimizer.submit(_problem(2))
    _assert_same(optimizer.result(), solve(_problem(2), CONFIG))
    assert not caplog.records


def test_a_process_killed_at_work_is_replaced_too(optimizer: WindowProcess) -> None:
    optimizer.submit(_problem())
    optimizer.result()
    os.kill(_pid(optimizer), signal.SIGSTOP)  # it cannot have answered when it is killed
    optimizer.submit(_problem(2))
    os.kill(_pid(optimizer), signal.SIGKILL)
    _assert_same(optimizer.result(), solve(_problem(2), CONFIG))


def test_a_window_that_kills_its_process_again_is_left_as_it_is(
    optimizer: WindowProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    optimizer.submit(_problem())
    optimizer.result()
    monkeypatch.setattr(child_module, "_PROGRAM", "import os; os.abort() # {path!r}")
    os.kill(_pid(optimizer), signal.SIGKILL)
    optimizer.submit(_problem(2))
    solution = optimizer.result()
    assert not solution.converged
    np.testing.assert_array_equal(solution.world_from_cam, _problem(2).world_from_cam)


def test_a_process_that_never_starts_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_module, "_PROGRAM", "raise SystemExit(3) # {path!r}")
    optimizer = _process()
    optimizer.submit(_problem())
    with pytest.raises(RuntimeError, match="does not start"):
        optimizer.result()
    optimizer.close()


def test_an_error_in_the_process_is_told(optimizer: WindowProcess) -> None:
    optimizer.submit("no window")  # type: ignore[arg-type]
    with pytest.raises(RuntimeError, match="the optimizer failed"):
        optimizer.result()
    optimizer.submit(_problem())
    assert optimizer.result().converged


def test_closing_ends_the_process_whatever_it_is_doing() -> None:
    optimizer = _process()
    pid = _pid(optimizer)
    optimizer.submit(_problem())
    optimizer.close()
    assert _has_ended(pid)
    with pytest.raises(RuntimeError, match="the optimizer was closed"):
        optimizer.result()


def test_a_forgotten_optimizer_takes_its_process_along() -> None:
    optimizer = _process()
    pid = _pid(optimizer)
    del optimizer
    assert _has_ended(pid)


_SCRIPT = """
import os, signal, sys
from vo.engine.backend.process import SolverProcess
optimizer = SolverProcess(len, len)
print(optimizer._child.pid, flush=True)
{end}
"""


@pytest.mark.parametrize(
    "end",
    ["", "os.kill(os.getpid(), signal.SIGKILL)", "raise KeyboardInterrupt", "os._exit(0)"],
    ids=["end", "kill", "interrupt", "exit"],
)
def test_no_process_outlives_a_script_that_does_not_close(end: str, tmp_path: Path) -> None:
    script = tmp_path / "script.py"  # without a guard around its main part
    script.write_text(_SCRIPT.format(end=end), encoding="utf-8")
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    assert _has_ended(int(done.stdout.split()[0]))
    assert done.stderr.count("Traceback") == (end == "raise KeyboardInterrupt")


@pytest.mark.parametrize("name", ["signal", "enum", "gc", "struct", "numpy", "vo", "sitecustomize"])
def test_modules_in_the_current_folder_are_not_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", ".", *sys.path])
    optimizer = _process()
    optimizer.submit(_problem())
    assert optimizer.result().converged
    optimizer.close()
    assert not (tmp_path / "run").exists()


def test_modules_are_found_where_the_parent_finds_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A factor of a user's own is unpickled in the process."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    found = child_module._import_path()
    assert str(tmp_path) in found
    assert str(Path(__file__).resolve().parents[3]) in found


@pytest.mark.parametrize("received", [b"Hello, world! " * 3, b"vowindow" + b"\xff" * 8])
def test_what_is_no_message_is_refused(received: bytes) -> None:
    with pytest.raises(OSError, match="is no message"):
        receive(io.BytesIO(received))
