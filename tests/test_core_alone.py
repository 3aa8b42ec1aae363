"""The core, with the packages of no extra: every other package is hidden from imports."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions
from pathlib import Path

import cv2
import numpy as np
import pytest
from dependencies import DISTRIBUTION, required
from package import _MAKE_CALIBRATION, _MAKE_VIDEO
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
NEEDS_EXTRA = {
    "vo.outputs.recorders.timelines": "pyarrow",
    "vo.recordings.formats.ros2": "rosbags",
    "vo.recordings.formats.ros_reading": "rosbags",
    "vo.recordings.sources.live.pyav_device": "av",
    "vo.recordings.sources.logs.video": "av",
    "vo.recordings.sources.video": "av",
    **{
        f"vo.outputs.recorders.{name}": "rerun"
        for name in (
            *(
                "dense_recording",
                "entities",
                "loop_layer",
                "map_layer",
                "plot_layer",
                "rerun_recorder",
            ),
            *("settled_layer", "sink", "view_layer"),
        )
    },
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


@pytest.fixture(scope="module")
def hide() -> str:
    """Code that hides the packages that the core does not require."""
    try:
        core = {*required(()), DISTRIBUTION}
    except PackageNotFoundError as error:
        pytest.skip(f"{error.name} is not installed; call scripts/setup dev")
    hidden = {
        package
        for package, owners in packages_distributions().items()
        if not core & {canonicalize_name(owner) for owner in owners}
    }
    assert {"av", "matplotlib", "rosbags", "rerun", "rerun_cli", "pyarrow"} <= hidden
    assert not {"numpy", "cv2", "gtsam", "mcap"} & hidden
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


@pytest.mark.parametrize("name", ["recording.py", "webcam.py", "stereo_rig.py"])
def test_examples_need_the_core_alone(
    hide: str, name: str, synthetic_stereo: Path, tmp_path: Path
) -> None:
    words = {
        "recording.py": [str(synthetic_stereo)],
        "webcam.py": ["camera.yaml", "clip.avi"],
        "stereo_rig.py": ["pair.yaml", "clip.avi", "clip.avi"],
    }[name]
    example = str(ROOT / "examples" / name)
    code = f"import runpy\nsys.argv = {[example, *words]!r}\nrunpy.run_path({example!r})"
    result = _run(hide + _MAKE_VIDEO + _MAKE_CALIBRATION + code, tmp_path)
    assert result.returncode == 0, result.stderr
    lines = [line for line in result.stdout.splitlines() if line != "complete"]
    assert len(lines) == (30 if name == "recording.py" else 9)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            "eval a.tum b.tum --picture p.png",
            "plots need the extra 'report': pip install 'visual-odometry[report]'",
        ),
        ("report .", "reports need the extra 'report': pip install 'visual-odometry[report]'"),
        (
            "calibrate --print-board b.pdf --board charuco --square 0.025",
            "printed boards need the extra 'report': pip install 'visual-odometry[report]'",
        ),
        (
            "synth x.mcap --to mcap-ros2",
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
    result = _run(hide + _call(command), tmp_path)
    assert result.returncode == 1
    assert result.stderr.strip() == f"error: {message}"
    assert result.stdout == ""


def test_a_run_needs_no_viewer(hide: str, tmp_path: Path) -> None:
    images = tmp_path / "walk"
    images.mkdir()
    for index in range(4):
        cv2.imwrite(str(images / f"{index}.png"), np.full((48, 64), 100 + index, np.uint8))
    (images / "calibration.yaml").write_text(
        "cam0:\n  resolution: [64, 48]\n  intrinsics: [50.0, 50.0, 31.5, 23.5]\n"
        "  distortion_model: none\n  distortion: []\n"
    )
    result = _run(hide + _call("run walk -o out"), tmp_path)
    assert (tmp_path / "out" / "summary.json").is_file(), result.stderr
    (tmp_path / "out" / "run.rrd").write_bytes(b"RRF2")
    needs = "need the extra 'view': pip install 'visual-odometry[view]'"
    for command, what in (
        ("run walk -o other --rrd run.rrd", "recordings for the viewer"),
        ("run walk -o other --spawn", "viewers"),
        ("view out", "viewers"),
        ("view out --web", "viewers"),
    ):
        result = _run(hide + _call(command), tmp_path)
        assert result.stderr == f"error: {what} {needs}\n"
        assert (result.returncode, result.stdout) == (1, "")
    assert not (tmp_path / "other").exists()


def _call(command: str) -> str:
    return f"sys.argv = ['vo', *{command.split()!r}]\nfrom vo.cli.entry import main\nmain()"
