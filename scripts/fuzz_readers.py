"""Reading of damaged inputs, by the code of the commands."""

from __future__ import annotations

import contextlib
import io
import json
import os
from collections.abc import Callable
from functools import cache
from itertools import islice
from pathlib import Path

from typer import testing

from vo.api.report_entries import read_entries
from vo.base.config import load_config
from vo.base.errors import ConfigError, VoError
from vo.base.geometry.rectification import rectified_rig
from vo.cli.app import app
from vo.engine.maps.map_file import MapFile
from vo.engine.places.vocabulary_file import read_vocabulary
from vo.outputs.report.page import make_page
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.formats.mesh import read_mesh
from vo.recordings.sources.imu_table import read_imu_table
from vo.recordings.sources.registry import open_source
from vo.runs.batch.job import Job
from vo.runs.batch.planning import plan
from vo.runs.scaling.positions import read_positions
from vo.tools.maps.contents import map_contents
from vo.tools.markers.marker_map import read_marker_map
from vo.tools.objects.database_file import read_objects

# All commands are built for each call, which takes longer than most files.
testing._get_command = cache(testing._get_command)

_FRAMES = 4


def _command(*words: str) -> None:
    """Execute a command of `vo` in this process."""
    result = testing.CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if result.exit_code:
        lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
        raise VoError(lines[0] if lines else f"status {result.exit_code}")


def _recording(path: Path, number: int) -> None:
    if number % 2:
        _command("info", str(path))
        return
    source = open_source(path)
    for _ in islice(source.frames(images="recorded" if number % 4 else "grey"), _FRAMES):
        pass
    _ = source.ground_truth
    for imu in source.imus:
        with contextlib.suppress(VoError):
            imu.read()


def _calibration(path: Path, number: int) -> None:
    size = json.loads((path.parent / "size").read_text("utf-8"))
    rig = read_calibration(path, None if size is None else (size[0], size[1])).rig
    if rig.is_stereo:
        rectified_rig(rig)


def _trajectory(path: Path, number: int) -> None:
    truth = str(path.with_name("truth"))
    words = (str(path), truth) if number % 2 else (truth, str(path))
    _command("eval", *words, *(["--json"] if number % 3 else []))


def _report(path: Path, number: int) -> None:
    if number % 10 == 2:
        _command("eval", str(path), str(path.parent / "truth"))
        return
    if number % 10 == 1:
        _command("report", str(path), "-o", str(path / "report.html"))
        return
    make_page(read_entries([path], None, number % 2 == 0), [])


def _config(path: Path, number: int) -> None:
    if number % 2:
        load_config(path)
    else:
        value = path.read_text("utf-8", errors="replace")[-number - 1 :]
        with contextlib.suppress(ConfigError):
            load_config(overrides=[f"features.count={value}"])


def _manifest(path: Path, number: int) -> None:
    plan([], Job("", ""), manifest=path)


def _map(path: Path, number: int) -> None:
    if number % 2:
        _command("map", "info", str(path), *(["--json"] if number % 4 == 1 else []))
        return
    with MapFile(path) as file:
        map_contents(file)


def _batch(path: Path, number: int) -> None:
    other = str(path.with_name("after"))
    words = (str(path), other) if number % 2 else (other, str(path))
    _command("compare", *words, *(["--json"] if number % 3 else []))


READERS: dict[str, Callable[[Path, int], None]] = {
    "recording": _recording,
    "calibration": _calibration,
    "trajectory": _trajectory,
    "report": _report,
    "config": _config,
    "positions": lambda path, _: read_positions(str(path)) and None,
    "markers": lambda path, _: read_marker_map(path) and None,
    "manifest": _manifest,
    "imu": lambda path, _: read_imu_table(path) and None,
    "mesh": lambda path, _: read_mesh(path) and None,
    "map": _map,
    "vocabulary": lambda path, _: read_vocabulary(path) and None,
    "objects": lambda path, _: read_objects(path) and None,
    "batch": _batch,
}


def read(reader: str, path: Path, number: int) -> str:
    """Read an input: `read`, or the line of its error.

    Raises:
        Exception: any other than those that become a line.
    """
    os.chdir(path.parent)
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            READERS[reader](path, number)
        except VoError as error:
            return f"error: {error}"
        except OSError as error:
            if error.errno is None:
                raise
            return f"error: {error.filename}: {error.strerror}"
    return "read"
