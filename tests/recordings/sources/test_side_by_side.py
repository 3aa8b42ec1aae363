"""Images that contain the left and the right image beside each other."""

from __future__ import annotations

import shutil
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.errors import SourceError
from vo.base.types import Frame
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.uncalibrated import open_uncalibrated
from vo.runs.run_recording import run

COUNT = 12


@pytest.fixture(scope="module")
def frames(synthetic_stereo: Path) -> list[Frame]:
    return list(islice(open_source(synthetic_stereo).frames(), COUNT))


@pytest.fixture(scope="module")
def folder(
    synthetic_stereo: Path, frames: list[Frame], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """As a program writes it that saves what the camera gives."""
    folder = tmp_path_factory.mktemp("both") / "images"
    folder.mkdir()
    for frame in frames:
        both = np.hstack([frame.image0, frame.image1])
        assert cv2.imwrite(str(folder / f"{frame.stamp_ns}.png"), both)
    write_calibration(folder / "calibration.yaml", open_source(synthetic_stereo).rig)
    return folder


def video(path: Path, frames: list[Frame]) -> Path:
    """A video without losses."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=20)
        height, width = frames[0].image0.shape
        stream.width, stream.height, stream.pix_fmt = 2 * width, height, "gray"
        for frame in frames:
            both = np.ascontiguousarray(np.hstack([frame.image0, frame.image1]))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(both, format="gray")))
        container.mux(stream.encode())
    return path


def assert_same(read: list[Frame], frames: list[Frame]) -> None:
    assert len(read) == len(frames)
    for one, other in zip(read, frames, strict=True):
        np.testing.assert_array_equal(one.image0, other.image0)
        np.testing.assert_array_equal(one.image1, other.image1)


def test_a_folder_is_read_as_pairs(folder: Path, frames: list[Frame]) -> None:
    source = open_source(folder, side_by_side=True)
    assert source.rig.is_stereo
    read = list(source.frames())
    assert_same(read, frames)
    assert [frame.stamp_ns for frame in read] == [frame.stamp_ns for frame in frames]
    assert source.unpaired == 0


def test_a_video_is_read_as_pairs(folder: Path, frames: list[Frame], tmp_path: Path) -> None:
    path = video(tmp_path / "walk.mkv", frames)
    shutil.copy(folder / "calibration.yaml", tmp_path)
    assert_same(list(open_source(path, side_by_side=True).frames()), frames)


def test_each_image_is_decoded_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[str] = []
    read = ImageFile.read

    def counting(self: ImageFile, colour: bool = False) -> np.ndarray:
        decoded.append(self.name)
        return read(self, colour)

    monkeypatch.setattr(ImageFile, "read", counting)
    source = open_source(folder, side_by_side=True)
    decoded.clear()
    assert len(list(source.frames())) == COUNT
    assert len(decoded) <= COUNT


def test_a_run_gives_the_poses_of_the_pairs(
    folder: Path, synthetic_stereo: Path, tmp_path: Path
) -> None:
    fast = load_config("fast", ["inertial.enabled=false"])  # the copy has no sensor
    run(synthetic_stereo, tmp_path / "pairs", config=fast, end=COUNT)
    run(folder, tmp_path / "both", config=fast, side_by_side=True)
    poses = [(tmp_path / name / "poses.csv").read_bytes() for name in ("pairs", "both")]
    assert poses[0] == poses[1]


def test_recordings_of_a_board_are_divided_too(folder: Path, frames: list[Frame]) -> None:
    source = open_uncalibrated(folder, side_by_side=True)
    assert source.rig.is_stereo
    height, width = frames[0].image0.shape
    assert (source.rig.cam0.width, source.rig.cam0.height) == (width, height)
    assert_same(list(source.frames()), frames)


def test_mono_uses_the_left_half(folder: Path, frames: list[Frame]) -> None:
    read = list(open_source(folder, side_by_side=True, mode="mono").frames())
    np.testing.assert_array_equal(read[0].image0, frames[0].image0)
    assert read[0].image1 is None


def test_what_has_no_two_halves_is_refused(
    folder: Path, synthetic_stereo: Path, tmp_path: Path
) -> None:
    with pytest.raises(SourceError, match="has right images of its own"):
        open_source(synthetic_stereo, side_by_side=True)
    odd = tmp_path / "odd"
    odd.mkdir()
    shutil.copy(folder / "calibration.yaml", odd)
    cv2.imwrite(str(odd / "1.png"), np.zeros((20, 31), np.uint8))
    with pytest.raises(SourceError, match="31 pixels wide: it has no two halves"):
        open_source(odd, side_by_side=True)
    (tmp_path / "log.mcap").write_bytes(b"\x89MCAP0\r\n")
    for open_it in (open_source, open_uncalibrated):
        with pytest.raises(SourceError, match="is a log: `side_by_side` is for videos and folders"):
            open_it(tmp_path / "log.mcap", side_by_side=True)


@pytest.mark.parametrize("where", ["beside each other", "one above the other", ""])
def test_a_pair_that_is_read_as_one_camera_is_named(
    tmp_path: Path, frames: list[Frame], where: str, caplog: pytest.LogCaptureFixture
) -> None:
    join = {"beside each other": np.hstack, "one above the other": np.vstack}
    for frame in frames[:3]:
        pair = [frame.image0, frame.image1]
        image = join[where](pair) if where else frame.image0
        cv2.imwrite(str(tmp_path / f"{frame.index}.png"), image)
    height, width = image.shape
    (tmp_path / "calibration.yaml").write_text(
        f"cam0: {{resolution: [{width}, {height}], "
        f"intrinsics: [300, 300, {width / 2}, {height / 2}]}}\n"
    )
    open_source(tmp_path)
    assert ("those of a stereo pair" in caplog.text) == bool(where)
    assert where in caplog.text
