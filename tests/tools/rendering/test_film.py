"""A video of a run: it shows the run's frames, features and path, and what is lost."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.config import load_config
from vo.base.types import Bytes
from vo.cli.app import app
from vo.runs.run_recording import run
from vo.tools import drawing
from vo.tools.rendering.film import _GREEN, _VERMILION

FRAMES, BLACK = 14, range(9, 11)


@pytest.fixture(scope="module")
def recording(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with black images."""
    folder = Path(shutil.copytree(synthetic_stereo, tmp_path_factory.mktemp("film") / "recording"))
    for camera in ("cam0", "cam1"):
        for path in sorted((folder / "mav0" / camera / "data").iterdir())[BLACK.start : BLACK.stop]:
            cv2.imwrite(str(path), np.zeros_like(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))
    return folder


@pytest.fixture(scope="module")
def finished(recording: Path) -> Path:
    folder = recording.parent / "out"
    run(recording, folder, config=load_config("fast"), end=FRAMES)
    return folder


def film(*arguments: str | Path, expect: int = 0) -> str:
    result = CliRunner().invoke(app, ["video", *map(str, arguments)])
    assert result.exit_code == expect, result.output
    return result.stdout if expect == 0 else " ".join(result.output.split())


def images_of(path: Path) -> list[Bytes]:
    video, images = cv2.VideoCapture(str(path)), []
    while True:
        is_read, image = video.read()
        if not is_read:
            return images
        images.append(image)


def near(image: Bytes, color: tuple[int, int, int]) -> int:
    """Number of pixels of about this colour, which a video changes somewhat."""
    return int((np.abs(image.astype(int) - color).max(axis=2) < 40).sum())


@pytest.mark.parametrize("has_pyav", [True, False])
def test_each_frame_of_the_run_is_shown_and_lost_ones_are_red(
    finished: Path, tmp_path: Path, has_pyav: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_pyav:
        monkeypatch.setattr(drawing, "_pyav", lambda: None)
    done = json.loads(film(finished, "-o", tmp_path / "a.mp4", "--width", "641", "--json"))
    assert (done["images"], done["frames"], done["lost"]) == (FRAMES, FRAMES, len(BLACK))
    assert done["differing"] == 0  # the same bits as in the run
    images = images_of(tmp_path / "a.mp4")
    assert len(images) == FRAMES and images[0].shape[1] == 642
    assert all(side % 2 == 0 for side in images[0].shape[:2])
    border = [image[40:200, :3] for image in images]
    for number, part in enumerate(border):
        color, other = (_VERMILION, _GREEN) if number in BLACK else (_GREEN, _VERMILION)
        assert near(part, color) > 5 * near(part, other) + 100
    # The path grows, and the images have features.
    beside = [near(image[:, 400:], _GREEN) for image in images]
    assert beside[1] < beside[6] < beside[-1]
    assert near(images[5][10:200, 10:360], _GREEN) > 200


def test_a_part_at_another_speed(finished: Path, tmp_path: Path) -> None:
    words = ["--start", "3", "--end", "8", "--speed", "0.5", "--json"]
    done = json.loads(film(finished, "-o", tmp_path / "a.mkv", *words))
    stamps = [
        int(row.split(",")[1]) for row in (finished / "frames.csv").read_text().splitlines()[1:]
    ]
    rate = 1e9 / float(np.median(np.diff(stamps)))
    assert done["images"] == 5 and done["rate"] == pytest.approx(0.5 * rate)
    fast = json.loads(film(finished, "-o", tmp_path / "b.mp4", "--speed", "10", "--json"))
    assert fast["rate"] <= 60.0 and fast["images"] == -(-FRAMES // round(10 * rate / fast["rate"]))


def test_a_recording_that_was_moved_is_named(
    recording: Path, finished: Path, tmp_path: Path
) -> None:
    moved = Path(shutil.copytree(finished, tmp_path / "moved"))
    summary = json.loads((moved / "summary.json").read_text())
    (moved / "summary.json").write_text(json.dumps({**summary, "source": "gone"}))
    output = tmp_path / "a.mp4"
    assert "gone does not exist" in film(moved, "-o", output, expect=1)
    assert "images      14 of 14 frames" in film(moved, recording, "-o", output)
    rows = (moved / "frames.csv").read_text().replace(",17", ",18")
    (moved / "frames.csv").write_text(rows)
    assert "this is not the recording of" in film(moved, recording, "-o", output, expect=1)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["-o", "a.gif"], "a.gif must end in .mp4, .avi, .mkv, .mov, which are written"),
        (["--start", "14"], "no frame of the run is from 14 to before 14; it has 0 to 13"),
        (["-o", "/proc/none/a.mp4"], "cannot be written"),
    ],
)
def test_what_cannot_be_filmed_is_told(
    finished: Path, tmp_path: Path, words: list[str], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert told in film(finished, *words, expect=1)


def test_a_run_without_frames_is_refused(finished: Path, tmp_path: Path) -> None:
    empty = Path(shutil.copytree(finished, tmp_path / "empty"))
    (empty / "frames.csv").write_text("")
    assert "has no frames.csv with frames" in film(empty, "-o", tmp_path / "a.mp4", expect=1)
