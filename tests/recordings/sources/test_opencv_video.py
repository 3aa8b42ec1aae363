"""Videos without PyAV: OpenCV's frames and times are those of PyAV, or the file is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import layouts
import numpy as np
import pytest
from video_files import COUNT, TICKS, expected_ns, number, picture, write

from vo.base.errors import MissingExtraError, SourceError
from vo.recordings.formats.messages import CompressedVideoMessage
from vo.recordings.sources.logs.images import image_factory
from vo.recordings.sources.opencv_video import OpenCvDecoder
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.video import PyavDecoder

COMMAND = r"pip install 'visual-odometry\[video\]'"


@pytest.fixture
def no_av(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return write(tmp_path / "clip.mp4", "libx264", g="10", bf="3")


def test_a_video_is_read_without_pyav_and_this_is_said(
    clip: Path, no_av: None, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_source(clip)
    frames = list(source.frames())
    assert source.stamps_ns.tolist() == expected_ns()
    assert [number(frame.image0) for frame in frames] == list(range(COUNT))
    [record] = caplog.records
    assert record.getMessage() == (
        f"{clip} is decoded by OpenCV; exact decoding and fast seeking need the extra 'video': "
        "pip install 'visual-odometry[video]'"
    )


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        ("a.mkv", "libx264", "yuv420p"),
        ("a.webm", "libvpx", "yuv420p"),
        ("a.mov", "mjpeg", "yuvj420p"),
        ("a.mp4", "libx265", "yuv420p"),
        ("a.mkv", "ffv1", "gray"),
    ],
)
def test_times_are_those_of_pyav_and_pictures_nearly(
    tmp_path: Path, name: str, codec: str, pixels: str
) -> None:
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    path = write(tmp_path / name, codec, pixels, **options)
    ours, exact = OpenCvDecoder(path), PyavDecoder(path)
    assert ours.stamps_ns == exact.stamps_ns
    for index in (0, 7, 6, COUNT - 1):
        difference = ours.read(index).astype(int) - exact.read(index)
        assert np.abs(difference).max() <= 3
        assert ours.read(index, colour=True).shape == (layouts.HEIGHT, layouts.WIDTH, 3)


def test_times_begin_at_zero(tmp_path: Path) -> None:
    path = write(tmp_path / "late.mp4", "libx264", ticks=[tick + 90000 for tick in TICKS])
    assert PyavDecoder(path).stamps_ns[0] == 10**9
    assert OpenCvDecoder(path).stamps_ns == expected_ns()


def test_avi_has_its_constant_rate(tmp_path: Path) -> None:
    size = (layouts.WIDTH, layouts.HEIGHT)
    path = tmp_path / "a.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 12.5, size)
    for i in range(20):
        writer.write(cv2.cvtColor(picture(i), cv2.COLOR_GRAY2BGR))
    writer.release()
    decoder = OpenCvDecoder(path)
    assert decoder.stamps_ns == [80_000_000 * i for i in range(20)]
    assert [number(decoder.read(i)) for i in (3, 19, 0)] == [3, 19, 0]


def test_times_that_are_not_of_display_are_replaced_and_this_is_said(
    clip: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """As for MP4 without a `ctts` box: OpenCV gives times that go back and forth."""
    open_it = cv2.VideoCapture

    class Unordered:
        def __init__(self, path: str, api: int) -> None:
            self._real = open_it(path, api)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._real, name)

        def get(self, key: int) -> float:
            value = float(self._real.get(key))
            return {cv2.CAP_PROP_POS_MSEC: -value, cv2.CAP_PROP_FPS: 25.0}.get(key, value)

    monkeypatch.setattr(cv2, "VideoCapture", Unordered)
    assert OpenCvDecoder(clip).stamps_ns == [40_000_000 * i for i in range(COUNT)]
    assert "times follow from its rate of 25 Hz" in caplog.text


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no video",
        b"#EXTM3U\n#EXTINF:1,\nhttp://example.org/a.ts\n",
        b"ffconcat version 1.0\nfile 'other.mp4'\n",
        b"\x00\x00\x00\x20ftypisom" + bytes(90),
    ],
)
def test_error_for_files_that_are_not_videos(
    tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(SourceError, match="cannot be opened as a video"):
        OpenCvDecoder(tmp_path / "a.mp4")
    assert capfd.readouterr() == ("", "")


def test_damage_in_the_middle_loses_some_frames(
    clip: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    data = bytearray(clip.read_bytes())
    start = data.index(b"mdat") + 4
    size = int.from_bytes(data[start - 8 : start - 4], "big")
    for position in range(start + size // 3, start + size * 2 // 3, 7):
        data[position] ^= 255
    clip.write_bytes(data)
    decoder = OpenCvDecoder(clip)
    assert 10 <= len(decoder.stamps_ns) < COUNT
    last = len(decoder.stamps_ns) - 1
    index = expected_ns().index(decoder.stamps_ns[last])
    assert number(decoder.read(last)) == index
    assert "frames cannot be decoded" in caplog.text
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("no_av")
def test_video_messages_need_the_extra() -> None:
    class Codec:
        kind = CompressedVideoMessage

    class Topic:
        codec = Codec

    with pytest.raises(MissingExtraError, match=f"video messages need .*{COMMAND}"):
        image_factory(None, Topic, [])  # type: ignore[arg-type]
