"""The smoother in a process of its own."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from windows import drive

from vo.backend import launch as child_module
from vo.backend.optimizer import InProcessOptimizer, make_optimizer, smooth
from vo.backend.process import OptimizerProcess
from vo.backend.solution import WindowSolution
from vo.config import SmoothingConfig
from vo.types import WindowProblem

CONFIG = SmoothingConfig()


@pytest.fixture
def smoother() -> Iterator[OptimizerProcess]:
    smoother = OptimizerProcess(CONFIG)
    yield smoother
    smoother.close()


def _problem(seed: int = 1) -> WindowProblem:
    return drive(stereo=True, fixed=1).with_noise(seed).with_guess().problem


def _assert_same(found: WindowSolution, expected: WindowSolution) -> None:
    assert found.converged and expected.converged
    assert found.left is not None and expected.left is not None
    np.testing.assert_array_equal(found.left.value, expected.left.value)
    for name in ("world_from_cam", "information", "points", "point_ok"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def _pid(smoother: OptimizerProcess) -> int:
    return smoother._child.pid


def _has_ended(pid: int) -> bool:
    for _ in range(200):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


def test_the_answer_is_the_same_as_in_this_process(smoother: OptimizerProcess) -> None:
    for seed in (1, 2):
        smoother.ask(_problem(seed))
        _assert_same(smoother.answer(), smooth(_problem(seed), CONFIG))


def test_a_killed_process_costs_a_warning_and_nothing_else(
    smoother: OptimizerProcess, caplog: pytest.LogCaptureFixture
) -> None:
    expected = smooth(_problem(), CONFIG)
    smoother.ask(_problem())
    _assert_same(smoother.answer(), expected)
    killed = _pid(smoother)
    os.kill(killed, signal.SIGKILL)
    with caplog.at_level(logging.WARNING):
        smoother.ask(_problem())
        _assert_same(smoother.answer(), expected)
    (record,) = caplog.records
    assert "died (status -9)" in record.getMessage()
    assert _pid(smoother) != killed
    caplog.clear()
    smoother.ask(_problem(2))
    _assert_same(smoother.answer(), smooth(_problem(2), CONFIG))
    assert not caplog.records


def test_a_process_killed_at_work_is_replaced_too(smoother: OptimizerProcess) -> None:
    smoother.ask(_problem())
    smoother.answer()
    os.kill(_pid(smoother), signal.SIGSTOP)  # it cannot have answered when it is killed
    smoother.ask(_problem(2))
    os.kill(_pid(smoother), signal.SIGKILL)
    _assert_same(smoother.answer(), smooth(_problem(2), CONFIG))


def test_a_window_that_kills_its_process_again_is_left_as_it_is(
    smoother: OptimizerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    smoother.ask(_problem())
    smoother.answer()
    monkeypatch.setattr(child_module, "_PROGRAM", "import os; os.abort() # {path!r}")
    os.kill(_pid(smoother), signal.SIGKILL)
    smoother.ask(_problem(2))
    solution = smoother.answer()
    assert not solution.converged
    np.testing.assert_array_equal(solution.world_from_cam, _problem(2).world_from_cam)


def test_a_process_that_never_starts_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_module, "_PROGRAM", "raise SystemExit(3) # {path!r}")
    smoother = OptimizerProcess(CONFIG)
    smoother.ask(_problem())
    with pytest.raises(RuntimeError, match="does not start"):
        smoother.answer()
    smoother.close()


def test_where_no_process_can_be_started_the_work_is_done_here(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with caplog.at_level(logging.WARNING):
        assert isinstance(make_optimizer(CONFIG, threads=2), InProcessOptimizer)
    assert "no other can be started" in caplog.text


def test_an_error_in_the_process_is_told(smoother: OptimizerProcess) -> None:
    smoother.ask("no window")  # type: ignore[arg-type]
    with pytest.raises(RuntimeError, match="the smoother failed"):
        smoother.answer()
    smoother.ask(_problem())
    assert smoother.answer().converged


def test_closing_ends_the_process_whatever_it_is_doing() -> None:
    smoother = OptimizerProcess(CONFIG)
    pid = _pid(smoother)
    smoother.ask(_problem())
    smoother.close()
    assert _has_ended(pid)
    with pytest.raises(RuntimeError, match="the smoother was closed"):
        smoother.answer()


def test_a_forgotten_smoother_takes_its_process_along() -> None:
    smoother = OptimizerProcess(CONFIG)
    pid = _pid(smoother)
    del smoother
    assert _has_ended(pid)


_SCRIPT = """
import os, signal, sys
from vo.backend.process import OptimizerProcess
from vo.config import SmoothingConfig
smoother = OptimizerProcess(SmoothingConfig())
print(smoother._child.pid, flush=True)
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
    root = Path(__file__).resolve().parents[2]
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


def test_its_program_does_without_the_settings() -> None:
    program = "import sys, vo.backend.worker; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
