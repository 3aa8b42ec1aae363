"""Sensors and positions that cameras other than GoPro's write into videos.

Bytes as the specification of CAMM, and parsers of Sony's and Insta360's files, describe them;
telemetry-parser 0.3 reads the same rates and accelerations from those of the last two.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import video_files
from typer.testing import CliRunner

from vo.cli.app import app
from vo.recordings.sources.camera_hint import camera_hint
from vo.recordings.sources.imu import ImuSamples
from vo.recordings.sources.motion_tracks import MotionTrack, read_motion_track
from vo.recordings.sources.registry import open_source
from vo.runs.scaling.positions import read_positions

MAGIC = b"8db42d694ccc418790edff439fe026bf"


def box(kind: bytes, *parts: bytes) -> bytes:
    data = b"".join(parts)
    return struct.pack(">I4s", 8 + len(data), kind) + data


def full(kind: bytes, *parts: bytes) -> bytes:
    """A box with version and flags."""
    return box(kind, bytes(4), *parts)


def with_track(clip: Path, kind: bytes, samples: list[tuple[int, bytes]]) -> Path:
    """A video with one more track, in milliseconds; FFmpeg wrote `moov` as its last box.

    `samples`: the length of each, and its bytes.
    """
    data = clip.read_bytes()
    at, moov = 0, b""
    while at < len(data):
        (size,) = struct.unpack_from(">I", data, at)
        if data[at + 4 : at + 8] == b"moov":
            data, moov = data[:at] + data[at + size :], data[at + 8 : at + size]
            continue
        at += size
    payload = b"".join(each for _, each in samples)
    count, ticks = len(samples), sum(each for each, _ in samples)
    offset = len(data) + 8
    table = box(
        b"stbl",
        full(b"stsd", struct.pack(">I", 1), box(kind, bytes(6), b"\0\1")),
        full(b"stts", struct.pack(">I", count), *(struct.pack(">II", 1, n) for n, _ in samples)),
        full(b"stsc", struct.pack(">IIII", 1, 1, count, 1)),
        full(
            b"stsz", struct.pack(">II", 0, count), *(struct.pack(">I", len(b)) for _, b in samples)
        ),
        full(b"stco", struct.pack(">II", 1, offset)),
    )
    track = box(
        b"trak",
        full(b"tkhd", struct.pack(">5I", 0, 0, 9, 0, ticks), bytes(60)),
        box(
            b"mdia",
            full(b"mdhd", struct.pack(">4I", 0, 0, 1000, ticks), bytes(4)),
            full(b"hdlr", bytes(4), b"meta", bytes(12), b"\0"),
            box(b"minf", full(b"nmhd"), table),
        ),
    )
    clip.write_bytes(data + box(b"mdat", payload) + box(b"moov", moov, track))
    return clip


def samples_of(path: Path) -> ImuSamples:
    track = read_motion_track(path)
    assert track is not None
    assert track.imu is not None
    return track.imu()


def camm(kind: int, layout: str, *values: float) -> bytes:
    return struct.pack("<HH" + layout, 0, kind, *values)


def test_camm(tmp_path: Path) -> None:
    rows = [(0, camm(1, "2i", 8_000_000, 21_000_000))]
    for n in range(100):
        rows.append((0, camm(2, "3f", 0.5, -0.25, 0.01 * n)))
        rows.append((10, camm(3, "3f", 0.0, 9.75, 0.5)))
    rows.append((0, camm(6, "di2d7f", 1.3e9, 3, 47.5, 8.5, 412.0, 1.5, 2.0, 0, 0, 0, 0)))
    rows.append((0, camm(6, "di2d7f", 1.3e9, 0, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0, 0)))  # no fix
    rows.append((5, camm(5, "3d", 47.25, 8.25, 400.0)[:-1]))  # cut
    clip = with_track(video_files.write(tmp_path / "clip.mp4", "libx264"), b"camm", rows)
    found = samples_of(clip)
    assert found.stamps_ns.tolist() == [10_000_000 * n for n in range(100)]
    assert found.gyro[3] == pytest.approx([0.5, -0.25, 0.03])
    assert found.accel[3].tolist() == [0.0, 9.75, 0.5]
    source = open_source(clip)
    assert source.imus[0].name.endswith("clip.mp4 (CAMM)")
    assert source.imus[0].cam0_from_imu is None
    assert camera_hint(clip, source.first_image, (64, 48)).readout_s == pytest.approx(0.021)
    positions = read_positions("auto", str(clip))
    assert positions.stamps_ns.tolist() == [1_000_000_000]
    text = CliRunner().invoke(app, ["info", str(clip)]).stdout
    assert "rows read within 21 ms, 1 positions of GPS (--gps auto)" in text
    assert "(CAMM): 100 samples" in text


def tag(number: int, value: bytes) -> bytes:
    return struct.pack(">HH", number, len(value)) + value


def vectors(first: int, scale: float, axes: int, rows: list[list[int]]) -> bytes:
    data = struct.pack(">2i", len(rows), 6) + np.array(rows, ">i2").tobytes()
    return b"".join(
        [
            tag(first + 5, struct.pack(">i", 100)),
            tag(first + 9, struct.pack(">f", scale)),
            tag(first + 10, struct.pack(">H", axes)),
            tag(first + 11, data),
        ]
    )


def sony_frame(n: int) -> bytes:
    """Two samples: axes 0x241 are -x, Z and Y; 131 and 4096 steps are 1 degree/s and 1 g."""
    gyro = vectors(0xE430, 131.0, 0x241, [[131, 262 + n, 0], [131, 262 + n, 13]])
    accel = vectors(0xE440, 4096.0, 0x420, [[0, 4096, 0], [0, 4096, 41]])
    user = bytes.fromhex("060e2b34025301010c0201017f010000")
    return (
        b"\0\x1c"
        + bytes(26)
        + user
        + tag(0x8300, tag(0x8004, b"\xd0\x1a"))
        + tag(0x8300, gyro + accel)
    )


def test_sony(tmp_path: Path) -> None:
    frames = [(40, sony_frame(n)) for n in range(20)]
    frames.append((40, sony_frame(0)[:90]))  # cut
    clip = with_track(video_files.write(tmp_path / "C0001.MP4", "libx264"), b"rtmd", frames)
    found = samples_of(clip)
    assert found.stamps_ns.tolist() == [20_000_000 * n for n in range(40)]
    # raw x is -x, raw y is z, raw z is y
    assert np.degrees(found.gyro[3]) == pytest.approx([-1.0, 13 / 131, 263 / 131])
    assert found.accel[3] == pytest.approx([0.0, 9.80665, 41 / 4096 * 9.80665])
    hint = camera_hint(clip, open_source(clip).first_image, (1920, 1080))
    assert hint.told_by == "26 mm of 35 mm film"
    assert hint.focal_px == pytest.approx(26 / np.hypot(36, 24) * np.hypot(1920, 1080))


def varint(value: int) -> bytes:
    value &= 2**64 - 1
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def field(number: int, value: int | float | bytes) -> bytes:
    if isinstance(value, float):
        return varint(number << 3 | 1) + struct.pack("<d", value)
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    return varint(number << 3 | 2) + varint(len(value)) + value


def with_trailer(clip: Path, *records: tuple[int, bytes]) -> Path:
    listed = b"".join(data + struct.pack("<BBI", 1, kind, len(data)) for kind, data in records)
    size = len(listed) + 72
    end = bytes(32) + struct.pack("<II", size, 3) + MAGIC
    clip.write_bytes(clip.read_bytes() + listed + end)
    return clip


@pytest.mark.parametrize("is_raw", [False, True])
def test_insta360(tmp_path: Path, is_raw: bool) -> None:
    facts = field(2, b"Insta360 GO 2") + field(24, 5_000 if not is_raw else 5_000_000)
    facts += field(25, 16.5) + field(62, int(is_raw))
    facts += field(65, field(1, 16) + field(2, 2000))
    rows = b""
    for n in range(200):
        if is_raw:
            steps = [32768, 32768 + 2048, 32768, 32768 + 164, 32768, 32768 - n]
            rows += struct.pack("<Q6H", 5_000_000 + 2000 * n, *steps)
        else:
            rows += struct.pack("<Q6d", 5_000 + 2 * n, 0.0, 1.0, 0.0, 0.175, 0.0, -0.001 * n)
    clip = video_files.write(tmp_path / "clip.mp4", "libx264")
    with_trailer(clip, (7, bytes(53)), (3, rows + b"cut"), (1, facts))
    track = read_motion_track(clip)
    assert track is not None
    assert (track.name, track.model) == ("Insta360", "Insta360 GO 2")
    assert track.readout_s == pytest.approx(0.0165)
    found = samples_of(clip)
    assert found.stamps_ns.tolist() == [2_000_000 * n for n in range(200)]
    rate = (
        np.radians([164 / 32768 * 2000, 0.0, -10 / 32768 * 2000]) if is_raw else [0.175, 0, -0.01]
    )
    assert found.gyro[10] == pytest.approx(rate)
    assert found.accel[10] == pytest.approx([0.0, 9.80665, 0.0])


def test_damaged_tracks_give_no_sensor(tmp_path: Path) -> None:
    clip = video_files.write(tmp_path / "clip.mp4", "libx264")
    whole = clip.read_bytes()
    rng = np.random.default_rng(5)
    assert read_motion_track(clip) is None
    for size in (0, 1, 71, 72, 2**32 - 1):
        clip.write_bytes(whole + bytes(32) + struct.pack("<II", size, 3) + MAGIC)
        assert read_motion_track(clip) is None
    for _ in range(50):
        clip.write_bytes(whole)
        with_trailer(clip, (3, rng.bytes(300)), (1, rng.bytes(80)))
        found = read_motion_track(clip)
        assert found is None or found.imu is None or np.isfinite(found.imu().gyro).all()
    for kind in (b"camm", b"rtmd"):
        clip.write_bytes(whole)
        frames = [(10, b"\0\x1c" + rng.bytes(60)) for _ in range(20)]
        frames += [(10, b"\0\0" + bytes([n % 8, 0]) + rng.bytes(n)) for n in range(40)]
        found = read_motion_track(with_track(clip, kind, frames))
        assert isinstance(found, MotionTrack)
        assert len(open_source(clip).stamps_ns) == video_files.COUNT
