"""Videos with several tracks, and of 16 bits."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import av
import cv2
import layouts
import numpy as np
import pytest
from av.stream import Disposition
from numpy.typing import NDArray

from vo.recordings.formats.warning_kinds import collected_warnings
from vo.recordings.sources.registry import open_source

COUNT = 5
COLOUR, GREY = ("COLOR", "mjpeg", "yuvj420p"), ("", "ffv1", "gray")
DEPTH, INFRARED = ("DEPTH", "ffv1", "gray16le"), ("IR", "ffv1", "gray16le")
COVER = ("cover", "png", "rgb24")


def scene(index: int) -> NDArray[np.uint16]:
    """Smooth, of 180 counts around 8400, as a thermal camera has."""
    y, x = np.mgrid[: layouts.HEIGHT, : layouts.WIDTH]
    return (8400 + 90 * np.sin(x / 4 + index) * np.cos(y / 5)).astype(np.uint16)


def _picture(track: int, index: int, pixels: str) -> av.VideoFrame:
    if pixels.startswith("gray16"):
        return av.VideoFrame.from_ndarray(scene(index), format="gray16le").reformat(format=pixels)
    image = np.full((layouts.HEIGHT, layouts.WIDTH), 40 * (track + 1), np.uint8)
    return av.VideoFrame.from_ndarray(image, format="gray").reformat(format=pixels)


def write(path: Path, *tracks: tuple[str, str, str]) -> Path:
    with av.open(str(path), "w") as container:
        streams = []
        for title, codec, pixels in tracks:
            stream = container.add_stream(codec, rate=10)
            stream.width, stream.height, stream.pix_fmt = layouts.WIDTH, layouts.HEIGHT, pixels
            stream.metadata["title"] = title
            if title == "cover":
                stream.disposition = Disposition.attached_pic
            streams.append(stream)
        for index in range(COUNT):
            for number, stream in enumerate(streams):
                if tracks[number] == COVER and index:
                    continue
                frame = _picture(number, index, tracks[number][2])
                frame.pts, frame.time_base = index, Fraction(1, 10)
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode())
    layouts.write_text(path.parent / "calibration.yaml", layouts.CALIBRATION)
    return path


@pytest.mark.parametrize(
    ("tracks", "used"),
    [
        ((DEPTH, COLOUR), 1),
        ((DEPTH, INFRARED, COLOUR), 2),
        ((DEPTH, GREY), 1),
        ((GREY, COLOUR), 1),
        ((COLOUR, COLOUR), 0),
    ],
)
def test_colour_is_preferred_to_grey_and_to_depth(
    tmp_path: Path, tracks: tuple[tuple[str, str, str], ...], used: int
) -> None:
    with collected_warnings() as warnings:
        source = open_source(write(tmp_path / "a.mkv", *tracks))
    frames = list(source.frames())
    assert len(frames) == COUNT
    assert all(abs(int(np.median(f.image0)) - 40 * (used + 1)) <= 1 for f in frames)
    (text,) = [each.text for each in warnings]
    assert f"has {len(tracks)} video tracks: 0 (" in text
    assert f"track {used} is used" in text


def test_advice_on_another_track(tmp_path: Path) -> None:
    path = write(tmp_path / "a b.mkv", DEPTH, COLOUR)
    with collected_warnings() as warnings:
        open_source(path)
    (command,) = re.findall("`(ffmpeg .*?)`", warnings[0].text)
    copied = tmp_path / "a b-0.mkv"
    assert command == f"ffmpeg -i '{path}' -map 0:v:0 -c copy '{copied}'"
    with av.open(str(path)) as container, av.open(str(copied), "w") as output:  # what it does
        stream = container.streams.video[0]
        target = output.add_stream_from_template(stream)
        for packet in container.demux(stream):
            if packet.dts is not None:
                packet.stream = target
                output.mux(packet)
    assert len(open_source(copied)) == COUNT


def test_infrared_is_preferred_to_depth_of_the_same_pixels(tmp_path: Path) -> None:
    with collected_warnings() as warnings:
        open_source(write(tmp_path / "a.mkv", DEPTH, INFRARED))
    assert "0 (DEPTH, gray16le), 1 (IR, gray16le); track 1 is used" in warnings[0].text


def test_a_cover_is_no_track(tmp_path: Path) -> None:
    with collected_warnings() as warnings:
        assert len(open_source(write(tmp_path / "a.mov", COVER, COLOUR))) == COUNT
    assert not warnings


@pytest.mark.parametrize(("codec", "pixels"), [("ffv1", "gray16le"), ("rawvideo", "gray16be")])
def test_video_of_16_bits_has_the_grey_levels_of_such_images(
    tmp_path: Path, codec: str, pixels: str
) -> None:
    video = write(tmp_path / f"a.{'mkv' if codec == 'ffv1' else 'mov'}", ("", codec, pixels))
    folder = tmp_path / "images"
    folder.mkdir()
    for index in range(COUNT):
        cv2.imwrite(str(folder / f"{index}.png"), scene(index))
    with collected_warnings() as warnings:
        frames = list(open_source(video).frames())
    assert "from about 8292 to 8507 of 14 bits" in warnings[0].text
    images = open_source(folder, calibration=tmp_path / "calibration.yaml")
    for frame, expected in zip(frames, images.frames(), strict=True):
        assert np.array_equal(frame.image0, expected.image0)
        assert np.ptp(frame.image0) > 190
    first = next(iter(open_source(video).frames(images="recorded")))
    assert np.array_equal(first.image0, scene(0))
