"""What scripts share: options, recordings, a timed `vo run`, and sections of pages."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"
CACHE = ROOT / "out" / "synth"
EXPERIMENTS = ROOT / "docs" / "experiments"
VO = Path(sys.executable).with_name("vo")
NO_PATH = 3  # exit status of `vo run` that no frame has a pose: a result, too
_TUM_CALIBRATION = """\
cam0:
  resolution: [640, 480]
  intrinsics: [535.4, 539.2, 320.1, 247.6]
"""
_SHARED_OPTIONS: dict[str, dict[str, Any]] = {
    "only": {"default": "", "metavar": "TEXT", "help": "only names that contain this"},
    "data": {"type": Path, "default": DATA, "metavar": "DIR", "help": "real recordings"},
    "cache": {"type": Path, "default": CACHE, "metavar": "DIR", "help": "rendered recordings"},
    "vo": {"type": Path, "default": VO, "metavar": "FILE", "help": "command to test"},
    "keep": {"type": Path, "metavar": "DIR", "help": "keep recordings and results here"},
    "json": {"type": Path, "metavar": "FILE", "help": "write every figure into this file"},
    "write": {"action": "store_true", "help": "write the result into its page of docs"},
    "config": {"default": "default", "help": "preset or file for `vo run`"},
    "set": {
        **{"action": "append", "default": [], "metavar": "KEY=VALUE"},
        "help": "setting for `vo run`",
    },
}


def parser_of(program: str, about: str | None, *shared: str) -> argparse.ArgumentParser:
    """A parser with these of the options that several scripts have."""
    parser = argparse.ArgumentParser(
        prog=f"scripts/{program}",
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for name in shared:
        parser.add_argument(f"--{name}", **_SHARED_OPTIONS[name])
    return parser


class VoRun(NamedTuple):
    """How a `vo run` ended, and what it cost with all its processes."""

    output: Path
    status: int
    stdout: str
    stderr: str
    wall_s: float
    cpu_s: float

    @property
    def failure(self) -> str:
        """The error line of a run without a result, else an empty string."""
        if self.status in (0, NO_PATH):
            return ""
        lines = self.stderr.strip().splitlines() or [f"exit status {self.status}"]
        return next((line for line in lines if line.startswith("error:")), lines[-1])

    @property
    def summary(self) -> dict[str, Any]:
        """The run's summary.json."""
        found: dict[str, Any] = json.loads((self.output / "summary.json").read_text("utf-8"))
        return found


def run_vo(
    recording: Path,
    output: Path,
    *options: str | Path,
    vo: Path = VO,
    timeout_s: float = threading.TIMEOUT_MAX,
) -> VoRun:
    """`vo run` as a user calls it; after the timeout it is killed, and its status is -9."""
    command = [str(part) for part in (vo, "run", recording, "--output", output, *options)]
    return run_timed(command, output, timeout_s)


def run_timed(command: list[str], output: Path, timeout_s: float = threading.TIMEOUT_MAX) -> VoRun:
    """Run a command that writes its result into a folder."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        begin = time.perf_counter()
        process = subprocess.Popen(command, stdout=out, stderr=err)
        timer = threading.Timer(timeout_s, process.kill)
        timer.daemon = True
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        wall_s = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        cpu_s = usage.ru_utime + usage.ru_stime
        return VoRun(output, process.returncode, out.read(), err.read(), wall_s, cpu_s)


def real_recordings(data: Path) -> list[Path]:
    """Folders of the real recordings."""
    return [p for p in sorted(data.glob("*_*")) if p.is_dir() and p.name != "eval_reference"]


def suite(cache: Path, *settings: str, group: str = "suite") -> dict[str, Callable[[], Path]]:
    """The synthetic suite: functions by name, which give the folder and render it where missing.

    `group`: `suite`, or `hard` for the set that is hard on purpose.
    """
    from data_synth.recipe import recipe_folder

    presets = sorted((recipe_folder() / group).glob("*.yaml"))
    return {p.stem: partial(rendered, cache, p.stem, p, *settings) for p in presets}


def rendered(cache: Path, name: str, preset: str | Path | None, *settings: str) -> Path:
    """The folder of a synthetic recording, rendered once."""
    from data_synth.cache import cached_sequence
    from data_synth.recipe import load_recipe

    cache.mkdir(parents=True, exist_ok=True)
    return cached_sequence(load_recipe(preset, list(settings)), cache, name)


def options_of(folder: Path, calibration: Path) -> list[str]:
    """Options that a real recording needs: TUM's have no calibration."""
    return ["--calibration", str(calibration)] if folder.name.startswith("tum_") else []


def write_tum_calibration(folder: Path) -> Path:
    """Write the calibration of the recordings of fr3; its path."""
    path = folder / "tum.yaml"
    path.write_text(_TUM_CALIBRATION, encoding="utf-8")
    return path


def write_section(page: Path, section: str, text: str) -> None:
    """Write new text between the marks of a section of a page."""
    begin, end = f"<!-- {section}: begin -->", f"<!-- {section}: end -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{rest.split(end)[1]}", encoding="utf-8")
