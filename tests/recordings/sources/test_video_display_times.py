"""Videos with B-frames in files that store no time of display, only the order of decoding."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import layouts
import numpy as np
import pytest
from av.video.codeccontext import VideoCodecContext

from vo.base.types import Bytes
from vo.recordings.sources.registry import open_source

COUNT = 40
RATE = 10
NOT_CODED = b"\x00\x00\x01\xb6\x51\x3f"
"""A picture of MPEG-4 that repeats the previous one; it fills the place of a packed B-frame."""

DIVX = b"\x00\x00\x01\xb2DivX503b1393p"
"""User data by which decoders recognise a packed bitstream."""


def picture(index: int) -> Bytes:
    return np.full((layouts.HEIGHT, layouts.WIDTH), 20 + 5 * index, np.uint8)


def number(image: Bytes) -> int:
    return round((float(np.median(image)) - 20) / 5)


def encode(name: str, **options: str) -> tuple[VideoCodecContext, list[av.Packet]]:
    """Packets of a coded video, in the order of decoding."""
    codec = av.CodecContext.create(name, "w")
    assert isinstance(codec, VideoCodecContext)
    codec.width, codec.height, codec.pix_fmt = layouts.WIDTH, layouts.HEIGHT, "yuv420p"
    codec.time_base, codec.framerate = Fraction(1, RATE), Fraction(RATE)
    codec.bit_rate, codec.thread_count, codec.options = 1_000_000, 1, options
    packets = []
    for i in range(COUNT):
        frame = av.VideoFrame.from_ndarray(picture(i), format="gray").reformat(format="yuv420p")
        frame.pts, frame.time_base = i, codec.time_base
        packets += codec.encode(frame)
    return codec, [*packets, *codec.encode(None)]


def mux(path: Path, codec: VideoCodecContext, coded: list[tuple[bytes, bool]]) -> Path:
    """Write packets with increasing times, as if they were in the order of display."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec.name, rate=RATE)
        stream.width, stream.height, stream.pix_fmt = layouts.WIDTH, layouts.HEIGHT, "yuv420p"
        if path.suffix == ".avi":
            stream.codec_context.codec_tag = "XVID" if codec.name == "mpeg4" else "H264"
        for i, (data, is_key) in enumerate(coded):
            packet = av.Packet(data)
            packet.stream, packet.time_base = stream, Fraction(1, RATE)
            packet.pts = packet.dts = i
            packet.is_keyframe = is_key
            container.mux(packet)
    layouts.write_text(path.parent / "calibration.yaml", layouts.CALIBRATION)
    return path


def packed(packets: list[av.Packet]) -> list[tuple[bytes, bool]]:
    """The layout of DivX and XviD: each first B-frame in the packet of the frame before it."""
    coded: list[tuple[bytes, bool]] = []
    is_b = [p.pts is not None and q.pts is not None and p.pts < q.pts
            for p, q in zip(packets[1:], packets, strict=False)]  # fmt: skip
    is_b = [False, *is_b]
    for at in range(1, len(packets)):  # of several B-frames, all are shown before the reference
        is_b[at] = is_b[at] or (is_b[at - 1] and not packets[at].is_keyframe
                                and packets[at].pts == packets[at - 1].pts + 1)  # fmt: skip
    groups: list[list[av.Packet]] = []
    for packet, follows in zip(packets, is_b, strict=True):
        groups = [*groups[:-1], [*groups[-1], packet]] if follows else [*groups, [packet]]
    for group in groups:
        first = bytes(group[0])
        if group[0].is_keyframe:
            at = first.index(b"\x00\x00\x01\xb6")
            first = first[:at] + DIVX + first[at:]
        datas = [first, *map(bytes, group[1:])]
        if len(datas) > 1:
            datas = [datas[0] + datas[1], *datas[2:], NOT_CODED]
        coded += [(data, i == 0 and bool(group[0].is_keyframe)) for i, data in enumerate(datas)]
    return coded


def in_order(packets: list[av.Packet]) -> list[tuple[bytes, bool]]:
    return [(bytes(packet), bool(packet.is_keyframe)) for packet in packets]


def check(path: Path) -> None:
    source = open_source(path)
    assert len(source) == COUNT
    steps = np.diff(source.stamps_ns)
    np.testing.assert_allclose(steps, 1e9 / RATE, atol=1e6)
    for start, end, stride in ((0, None, 1), (0, None, 1), (17, None, 1), (3, 9, 1), (0, 40, 13)):
        frames = list(source.frames(start, end, stride))
        expected = list(range(COUNT))[start:end:stride]
        assert not source.skipped
        assert [f.index for f in frames] == [number(f.image0) for f in frames] == expected
        assert [f.stamp_ns for f in frames] == source.stamps_ns[expected].tolist()


@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.avi"])
@pytest.mark.parametrize("gop", [{"g": "10"}, {"g": "12", "x264-params": "open-gop=1"}])
def test_h264(tmp_path: Path, name: str, gop: dict[str, str]) -> None:
    codec, packets = encode("libx264", bf="3", **gop)
    assert any(a.pts > b.pts for a, b in zip(packets, packets[1:], strict=False))
    check(mux(tmp_path / name, codec, in_order(packets)))


def test_h265(tmp_path: Path) -> None:
    codec, packets = encode("libx265", g="10", bf="3", **{"x265-params": "log-level=none"})
    check(mux(tmp_path / "a.mp4", codec, in_order(packets)))


@pytest.mark.parametrize("bf", ["1", "2"])
@pytest.mark.parametrize("layout", [packed, in_order])
@pytest.mark.parametrize("name", ["a.avi", "a.mkv"])
def test_mpeg4_of_xvid(tmp_path: Path, bf: str, layout: object, name: str) -> None:
    codec, packets = encode("mpeg4", g="12", bf=bf, b_strategy="0")
    assert callable(layout)
    check(mux(tmp_path / name, codec, layout(packets)))
