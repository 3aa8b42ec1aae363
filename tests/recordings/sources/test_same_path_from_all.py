"""The trajectory does not depend on the container of the images."""

from __future__ import annotations

from pathlib import Path

import container_copies
import pytest
from bag_logs import write_bag1, write_bag2
from mcap_logs import write_log

from vo.base.config import load_config
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FAST = load_config("fast", ["inertial.enabled=false"])  # logs and videos have no sensor
FRAMES = 12
LOGS = {"a.bag": write_bag1, "bag": write_bag2, "a.mcap": write_log}


def path_of(recording: Path, output: Path, mode: str) -> bytes:
    run(recording, output, config=FAST, mode=mode, end=FRAMES)  # type: ignore[arg-type]
    return (output / "trajectory.tum").read_bytes()


@pytest.fixture(scope="module")
def from_folder(
    synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    output = tmp_path_factory.mktemp("folder")
    return {mode: path_of(synthetic_stereo, output / mode, mode) for mode in ("stereo", "mono")}


@pytest.mark.parametrize("codec", ["mono8", "png"])
@pytest.mark.parametrize("name", LOGS)
def test_logs_give_identical_results(
    synthetic_stereo: Path, tmp_path: Path, from_folder: dict[str, bytes], name: str, codec: str
) -> None:
    write = LOGS[name]
    path = tmp_path / name
    write(path, container_copies.messages(open_source(synthetic_stereo), codec))
    assert path_of(path, tmp_path / "out", "stereo") == from_folder["stereo"]


def test_patterns_give_identical_results(
    synthetic_stereo: Path, tmp_path: Path, from_folder: dict[str, bytes]
) -> None:
    pattern = container_copies.write_glob(tmp_path / "glob", open_source(synthetic_stereo))
    pattern = pattern.with_name("left_*.*")
    assert path_of(pattern, tmp_path / "out", "stereo") == from_folder["stereo"]


def test_lossless_video_gives_the_same_poses(
    synthetic_stereo: Path, tmp_path: Path, from_folder: dict[str, bytes]
) -> None:
    video = container_copies.write_video(tmp_path / "a.mov", open_source(synthetic_stereo))
    found = path_of(video, tmp_path / "out", "mono")
    assert [line.split()[1:] for line in found.splitlines()] == [
        line.split()[1:] for line in from_folder["mono"].splitlines()
    ]
