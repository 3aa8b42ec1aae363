"""Each command of README and the pages is a whole call, and runs on files of the names it has."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from page_files import make_files
from typer.testing import CliRunner

from vo.cli.app import app

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# Run as something shorter, or on a file in place of a device, an address or a long video.
SHORTER = {
    r"vo demo$": "vo demo --help",
    r"(vo synth \S+ (?!.*panorama).*)": r"\1 --seconds 1.5 --set scale=0.25",
    r"(vo synth \S+ .*panorama.*)": r"\1 --seconds 1.5 --set scale=0.75",  # whose views are small
    "--preset kitti": "--preset kitti --world corridor",  # whose street takes longest to build
    "--world street": "--world warehouse",
    r"(vo sweep .*)--trials 40": r"\1--trials 1",
    "features.count=800,1500,3000 --try window.iterations=4,8": "features.count=800",
    r"(drive|clip|monday|tuesday)\.mp4": "drive.mcap",
    r"0,300,620,260,1240,300,1240,376,0,376": "0,200,200,180,399,200,399,250,0,250",
    r"right:0,340,1241,36": "right:0,230,400,20",
    r"--roi 0,40,1241,260": "--roi 0,40,400,200",
    r"--in-front 40:6": "--in-front 10:6",
    r"gps\.nmea": "gps.csv",
    r"(vo calibrate board.*)": r"\1 --force",
    r"--start 100 --end 400 --width 1920": "--start 4 --end 8 --width 640",
    r"--start 100 --end 600": "--start 4 --end 9",
}
# Not run: what needs a network, a device, a window, another program, or large recordings.
NOT_RUN = {
    "s3://": "an object store",
    "camera:0": "a device",
    r"vo view": "a window; tests/cli/test_view_command.py",
    r"vo models fetch": "a network; tests/engine/learned",
    "xfeat": "weights from the network",
    "lighterglue": "weights from the network",
    r"mug|walk\.mp4": "an object in view; tests/tools/objects",
    r"sweep/best": "a trial that is better; tests/runs/batch",
    r"--wheel auto": "a robot's log; tests/runs/test_wheel_run.py",
    r"vo demo|vo warmup": "a minute; tests/cli/test_demo.py",
    r"vo markers walk": "markers in a recording; tests/cli/test_markers_command.py",
    r"--imu": "a board that swings; tests/tools/calibrating",
}


def blocks(page: Path) -> list[str]:
    """Lines of the blocks of code that call `vo`, without comments and results."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"^ *```(\w*)\n(.*?)^ *```", text, re.S | re.M)
    lines = [
        line.strip() for kind, code in found if kind in ("", "sh") for line in code.split("\n")
    ]
    return [re.split(r"\s+#\s", line)[0] for line in map(str.strip, lines) if line[:3] == "vo "]


COMMAND: Any = typer.main.get_command(app)
CALLS = [(page.name, line) for page in PAGES for line in dict.fromkeys(blocks(page))]


@pytest.mark.parametrize(("page", "line"), CALLS)
def test_a_command_is_a_whole_call(page: str, line: str) -> None:
    """Also values of options, and arguments that must be given."""
    name, *words = shlex.split(re.split(r" > | \|", line)[0])[1:]
    COMMAND.commands[name].make_context(name, words, resilient_parsing=False).close()


# What is None without a calibration or a fit may be used. Other options are those of
# tests/api/test_commands.py, so that mypy knows the package already.
PRELUDE = """# mypy: disable-error-code="union-attr, no-untyped-def, no-untyped-call"
from typing import Any

import vo

camera: Any
stream: Any
image: Any
mask: Any
"""


def test_python_lines_use_the_interface_as_it_is(tmp_path: Path) -> None:
    """Names, arguments and their types; tests/test_tutorial_page.py runs those of the tutorial."""
    pytest.importorskip("mypy")
    programs = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found = re.findall(r"```python\n(.*?)```", text, re.S)
        program = tmp_path / f"page_{page.stem.replace('-', '_').lower()}.py"
        program.write_text("\n".join([PRELUDE, *found]), encoding="utf-8")
        programs += [str(program)] if found else []
    assert len(programs) > 6
    words = ["--strict", "--config-file=", "--follow-imports=silent", "--warn-unused-ignores"]
    result = subprocess.run(
        [sys.executable, "-m", "mypy", *words, "--ignore-missing-imports", *programs],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout


def is_run(line: str) -> bool:
    return not any(re.search(pattern, line) for pattern in NOT_RUN)


@pytest.fixture(scope="module")
def files(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    make_files(synthetic_stereo, folder)
    return folder


# tests/test_tutorial_page.py runs that of the tutorial.
RUN = [page for page in PAGES if any(map(is_run, blocks(page))) and page.stem != "tutorial"]


@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_commands_run(
    page: Path, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for entry in files.iterdir():
        if entry.name == "out":
            if page.name in ("report.md", "render.md"):  # others make it
                shutil.copytree(entry, tmp_path / "out")
        elif entry.is_dir():
            (tmp_path / entry.name).symlink_to(entry)
        else:
            shutil.copy(entry, tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in filter(is_run, blocks(page)):
        call = line
        for pattern, shorter in SHORTER.items():
            call = re.sub(pattern, shorter, call)
        words = shlex.split(re.split(r" > | \|", call)[0])[1:]
        result = CliRunner().invoke(app, words, catch_exceptions=False)
        assert result.exit_code == 0, f"{line}: {result.output}"
