"""A log through a pipe."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import layouts
from mcap_logs import write_log


def test_a_log_through_a_pipe_is_read_as_far_as_asked_for(tmp_path: Path) -> None:
    """The pipe stays open, as that of a recorder that goes on."""
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
        assert process.wait(120) == 0, process.stderr.read().decode()
        errors = process.stderr.read().decode()
    assert "Fatal" not in errors and "Traceback" not in errors
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert (summary["format"], summary["frames"]) == ("mcap", 3)
