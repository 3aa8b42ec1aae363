"""A log through a pipe."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import layouts
from mcap_logs import write_log


def test_log_through_a_pipe_is_read_up_to_the_last_frame(tmp_path: Path) -> None:
    """The pipe stays open, as with a recorder that continues."""
    log = write_log(tmp_path / "log.mcap", layouts.log_messages(), chunk_size=8_000)
    program = "from vo.cli.app import app; app()"
    output = tmp_path / "out"
    with subprocess.Popen(
        [sys.executable, "-c", program, "run", "-", "-o", str(output), "--end", "3"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None and process.stderr is not None
        process.stdin.write(log.read_bytes())
        process.stdin.flush()
        assert process.wait(120) == 3, process.stderr.read().decode()
        errors = process.stderr.read().decode()
    assert "Fatal" not in errors and "Traceback" not in errors
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert (summary["format"], summary["frames"]) == ("mcap", 3)
    assert summary["source"] == "standard input"


def vo_run(tmp_path: Path, stdin: bytes | None) -> tuple[int, str, str]:
    """Exit status, standard error and the summary, if any."""
    output = tmp_path / "out"
    program = [sys.executable, "-c", "from vo.cli.app import app; app()"]
    done = subprocess.run(
        [*program, "run", "-", "-o", str(output)], input=stdin, capture_output=True, timeout=120
    )
    summary = output / "summary.json"
    content = summary.read_text(encoding="utf-8") if summary.exists() else ""
    return done.returncode, done.stderr.decode(), content


def test_errors_name_standard_input(tmp_path: Path) -> None:
    status, errors, _ = vo_run(tmp_path, b"no log" * 100)
    assert status == 1
    assert errors == "error: standard input is not an MCAP file: its first bytes differ\n"


def test_warnings_name_standard_input(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap", layouts.log_messages(), chunk_size=8_000)
    whole = log.read_bytes()
    status, errors, summary = vo_run(tmp_path, whole[: 6 * len(whole) // 10])
    assert status == 3, errors
    assert "warning: standard input is cut off or damaged" in errors
    assert "/tmp" not in errors and ".mcap" not in errors
    assert json.loads(summary)["source"] == "standard input"
    assert ".mcap" not in summary


def test_error_for_a_closed_standard_input(tmp_path: Path) -> None:
    program = "import os; os.close(0); os.execvp(VO, [VO, 'run', '-', '-o', 'out'])"
    vo = str(Path(sys.executable).with_name("vo"))
    done = subprocess.run(
        [sys.executable, "-c", program.replace("VO", repr(vo))],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: no data on standard input")
    assert not (tmp_path / "out").exists()
