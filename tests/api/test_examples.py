"""The files under examples/, each run as a user would."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import vo

EXAMPLES = Path(__file__).parents[2] / "examples"
STATE = re.compile(r"(?:\d+ )?(starting|tracking|lost) (None|\[.*\])")


def states(name: str, folder: Path, *words: str | Path) -> list[str]:
    """The state of each frame that an example prints."""
    command = [sys.executable, EXAMPLES / name, *words]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OPENBLAS", "NUMBA_C"))}
    environment |= {k: v for k, v in os.environ.items() if k == "NUMBA_CACHE_DIR"}
    result = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300, env=environment
    )
    assert result.returncode == 0, result.stderr
    lines = [line for line in result.stdout.splitlines() if line != "complete"]
    matches = [STATE.fullmatch(line) for line in lines]
    assert all(matches), result.stdout
    return [match[1] for match in matches if match]


@pytest.fixture(scope="module")
def videos(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The walk as one motion JPEG video for each camera, as from two devices."""
    recording = vo.open(synthetic_stereo)
    folder = tmp_path_factory.mktemp("videos")
    paths = [folder / "left.avi", folder / "right.avi"]
    size = recording.rig.cam0.width, recording.rig.cam0.height
    writers = [
        cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, size) for path in paths
    ]
    for frame in recording.frames():
        for writer, image in zip(writers, frame.images, strict=True):
            assert image is not None
            writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    for writer in writers:
        writer.release()
    vo.write_calibration(folder / "camera.yaml", recording.rig)
    return paths


def test_recording(synthetic_stereo: Path, tmp_path: Path) -> None:
    assert states("recording.py", tmp_path, synthetic_stereo) == ["tracking"] * 30
    path = vo.read_trajectory(tmp_path / "trajectory.tum")
    evaluation = vo.evaluate(path, synthetic_stereo / "groundtruth.tum")
    assert evaluation.ate.translation_m.max() < 0.01


def test_webcam(videos: list[Path], tmp_path: Path) -> None:
    """One camera: the first frames have no map yet."""
    calibration = videos[0].with_name("camera.yaml")
    lens = vo.Rig(vo.read_calibration(calibration).rig.cam0)
    vo.write_calibration(tmp_path / "webcam.yaml", lens)
    found = states("webcam.py", tmp_path, "webcam.yaml", videos[0])
    assert len(found) == 30
    assert found[-1] == "tracking"


def test_stereo_rig(videos: list[Path], tmp_path: Path) -> None:
    calibration = videos[0].with_name("camera.yaml")
    assert states("stereo_rig.py", tmp_path, calibration, *videos) == ["tracking"] * 30


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda p: p.name)
def test_examples_are_short(path: Path) -> None:
    code = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    assert len(code) <= 17
    assert np.all([len(line) <= 100 for line in code])
