"""Videos: stamps from the container, seeking, rotated pictures, damage."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import layouts
import numpy as np
import pytest
from video_files import COUNT, expected_ns, number, picture, write

from vo.base.errors import CalibrationError, SourceError
from vo.recordings.sources.registry import open_source


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """H.264 with B-frames, a keyframe every ten frames, and a variable rate."""
    return write(tmp_path / "clip.mp4", "libx264", g="10", bf="3")


def test_variable_rates_are_exact(clip: Path) -> None:
    source = open_source(clip)
    frames = list(source.frames())
    assert (source.name, source.format, len(source)) == ("clip", "video", COUNT)
    assert [f.stamp_ns for f in frames] == source.stamps_ns.tolist() == expected_ns()
    assert [number(f.image0) for f in frames] == list(range(COUNT))


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "unit_ns"),
    [
        ("a.mkv", "libx264", "yuv420p", 1_000_000),  # Matroska's unit is a millisecond
        ("a.webm", "libvpx", "yuv420p", 1_000_000),
        ("a.mov", "mjpeg", "yuvj420p", 1),
        ("a.mkv", "ffv1", "gray", 1_000_000),
        ("a.mp4", "libx265", "yuv420p", 1),
    ],
)
def test_reads_other_containers_and_codecs(
    tmp_path: Path, name: str, codec: str, pixels: str, unit_ns: int
) -> None:
    frames = list(open_source(write(tmp_path / name, codec, pixels)).frames())
    assert [number(f.image0) for f in frames] == list(range(COUNT))
    stamps = np.array([f.stamp_ns for f in frames])
    np.testing.assert_allclose(stamps, expected_ns(), rtol=0, atol=unit_ns / 2)


def test_reads_avi_with_its_constant_rate(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (layouts.WIDTH, layouts.HEIGHT)
    )
    for i in range(COUNT):
        writer.write(cv2.cvtColor(picture(i), cv2.COLOR_GRAY2BGR))
    writer.release()
    layouts.write_text(tmp_path / "a.yaml", layouts.CALIBRATION)
    frames = list(open_source(path).frames())
    assert [f.stamp_ns for f in frames] == [i * 40_000_000 for i in range(COUNT)]
    assert [number(f.image0) for f in frames] == list(range(COUNT))


@pytest.mark.parametrize(
    "chosen", [(0, None, 1), (3, 6, 1), (17, None, 1), (5, 40, 13), (39, 40, 1)]
)
def test_seeks_to_the_exact_frame(clip: Path, chosen: tuple[int, int | None, int]) -> None:
    source = open_source(clip)
    wanted = list(range(COUNT))[slice(*chosen)]
    for _ in range(2):
        frames = list(source.frames(*chosen))
        assert [number(f.image0) for f in frames] == [f.index for f in frames] == wanted


def test_file_is_closed_when_reading_ends(clip: Path) -> None:
    def is_open() -> bool:
        handles = [Path(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd")]
        return any(handle.exists() and handle.resolve() == clip.resolve() for handle in handles)

    source = open_source(clip)
    frames = source.frames()
    next(frames)
    assert is_open()
    frames.close()  # type: ignore[attr-defined]
    assert not is_open()
    list(source.frames())
    assert not is_open()


def test_rotated_pictures_are_turned_upright(clip: Path) -> None:
    """The display matrix of a phone held upright, compared with OpenCV's interpretation."""
    data = bytearray(clip.read_bytes())
    matrix = data.index(b"tkhd") + 4 + 40
    turned = [0, 1 << 16, 0, -(1 << 16) % 2**32, 0, 0, 0, 0, 1 << 30]
    data[matrix : matrix + 36] = b"".join(value.to_bytes(4, "big") for value in turned)
    clip.write_bytes(data)
    size = f"[{layouts.HEIGHT}, {layouts.WIDTH}]"
    text = layouts.CALIBRATION.replace(f"[{layouts.WIDTH}, {layouts.HEIGHT}]", size)
    layouts.write_text(clip.with_suffix(".yaml"), text)
    image = next(iter(open_source(clip).frames())).image0
    capture = cv2.VideoCapture(str(clip))
    reference = cv2.cvtColor(capture.read()[1], cv2.COLOR_BGR2GRAY)
    capture.release()
    assert image.shape == reference.shape == (layouts.WIDTH, layouts.HEIGHT)
    assert np.abs(image.astype(int) - reference).max() <= 3


def test_calibration_with_the_name_of_the_video_is_preferred(clip: Path) -> None:
    text = layouts.CALIBRATION.replace("intrinsics: [50.0", "intrinsics: [77.0")
    layouts.write_text(clip.with_suffix(".yaml"), text)
    assert open_source(clip).rig.cam0.fx == 77.0
    for path in clip.parent.glob("*.yaml"):
        path.unlink()
    with pytest.raises(CalibrationError, match="looked for .*clip.yaml"):
        open_source(clip)


def test_error_for_stereo(clip: Path) -> None:
    with pytest.raises(SourceError, match="no images of a right camera"):
        open_source(clip, mode="stereo")


@pytest.mark.parametrize("content", [b"", b"no video", b"\x00\x00\x00\x20ftypisom" + bytes(90)])
def test_error_for_files_that_are_not_videos(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(SourceError, match="cannot be opened as a video"):
        open_source(tmp_path / "a.mp4")


def test_error_for_a_truncated_mp4(clip: Path) -> None:
    clip.write_bytes(clip.read_bytes()[:-200])
    with pytest.raises(SourceError, match="a truncated MP4 file cannot be recovered"):
        open_source(clip)


def test_truncated_matroska_file_is_read_up_to_the_end(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mkv", "ffv1", "gray")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    source = open_source(path)
    frames = list(source.frames())
    assert 10 < len(frames) < 30
    assert [number(f.image0) for f in frames] == list(range(len(frames)))
    assert len(source) - len(frames) == len(source.skipped) <= 1


def test_damage_in_the_middle_loses_some_frames(
    clip: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(clip.read_bytes())
    start = data.index(b"mdat") + 4
    size = int.from_bytes(data[start - 8 : start - 4], "big")
    for position in range(start + size // 3, start + size * 2 // 3, 7):
        data[position] ^= 255
    clip.write_bytes(data)
    source = open_source(clip)
    frames = list(source.frames())
    assert len(frames) + len(source.skipped) == COUNT
    assert 10 <= len(frames) < COUNT
    assert number(frames[-1].image0) == frames[-1].index == COUNT - 1
    assert capfd.readouterr() == ("", "")
