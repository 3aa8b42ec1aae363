"""The core, with the packages of no extra: every other package is hidden from imports."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NEEDS_EXTRA = {
    "vo.formats.ros2": "rosbags",
    "vo.formats.ros_reading": "rosbags",
    "vo.sources.live.pyav_device": "av",
    "vo.sources.logs.video": "av",
    "vo.sources.video": "av",
    "vo.sources.video_index": "av",
}
"""Modules that import an optional package at their top; others import them inside functions."""

HIDE = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {hidden!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
sys.path.insert(0, {root!r})
"""


def requirements(name: str, extras: frozenset[str]) -> set[str]:
    """Names of the distributions that a distribution requires, with some of its extras."""
    found = set()
    for line in distribution(name).requires or []:
        requirement, _, condition = line.partition(";")
        extra = re.search(r"extra == ['\"]([^'\"]+)", condition)
        if extra is None or extra[1] in extras:
            found.add(re.split(r"[^A-Za-z0-9._-]", requirement.strip())[0])
    return found


def closure(name: str) -> set[str]:
    """A distribution and all that it requires, directly or not, in normalised names."""
    reached: set[str] = set()
    waiting = {name}
    while waiting:
        each = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if each not in reached:
            try:
                waiting |= requirements(each, frozenset())
            except PackageNotFoundError:
                continue  # for other systems or versions of Python
            reached.add(each)
    return reached


@pytest.fixture(scope="module")
def hide() -> str:
    """Code that hides the packages that the core does not require."""
    core = closure("visual-odometry")
    normalised = {
        package: {re.sub(r"[-_.]+", "-", owner).lower() for owner in owners}
        for package, owners in packages_distributions().items()
    }
    hidden = {package for package, owners in normalised.items() if not owners & core}
    assert {"av", "matplotlib", "rosbags"} <= hidden
    assert not {"numpy", "cv2", "gtsam", "rerun", "mcap"} & hidden
    return HIDE.format(hidden=hidden, root=str(ROOT))


def _run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=120
    )


def test_all_modules_are_imported_with_the_core_alone(hide: str, tmp_path: Path) -> None:
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for package in ("vo", "data_synth")
        for path in sorted((ROOT / package).rglob("*.py"))
        if path.name != "__main__.py"
    ]
    code = f"""
import importlib
for name in {modules}:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        print(name, error.name.split(".")[0])
"""
    result = _run(hide + code, tmp_path)
    assert result.returncode == 0, result.stderr
    assert dict(line.split() for line in result.stdout.splitlines()) == NEEDS_EXTRA


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("report .", "reports need the extra 'report': pip install 'visual-odometry[report]'"),
        (
            "calibrate --print-board b.pdf --board charuco --square 0.025",
            "printed boards need the extra 'report': pip install 'visual-odometry[report]'",
        ),
        (
            "synth x.mcap --format mcap-ros2",
            "ROS messages need the extra 'ros': pip install 'visual-odometry[ros]'",
        ),
        ("info log.mcap", "ROS messages need the extra 'ros': pip install 'visual-odometry[ros]'"),
    ],
)
def test_a_missing_extra_is_told_in_one_line(
    hide: str, tmp_path: Path, command: str, message: str
) -> None:
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
        channel = writer.register_channel("/camera", "cdr", schema)
        writer.add_message(channel, log_time=0, data=b"", publish_time=0)
        writer.finish()
    code = f"sys.argv = ['vo', *{command.split()!r}]\nfrom vo.cli.entry import main\nmain()"
    result = _run(hide + code, tmp_path)
    assert result.returncode == 1
    assert result.stderr.strip() == f"error: {message}"
    assert result.stdout == ""
