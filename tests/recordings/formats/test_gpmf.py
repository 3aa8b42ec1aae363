"""GPMF of GoPro cameras: values, axes and times, and files that are damaged."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from vo.recordings.formats.gpmf import entries, read_streams
from vo.recordings.formats.mp4_boxes import Payload, read_mp4
from vo.recordings.sources.gopro import open_gopro
from vo.recordings.sources.imu_only import open_imu


def klv(key: str, kind: str, size: int, data: bytes) -> bytes:
    head = struct.pack(">4scBH", key.encode(), kind.encode() or b"\0", size, len(data) // size)
    return head + data + bytes(-len(data) % 4)


def nested(key: str, *parts: bytes) -> bytes:
    return klv(key, "", 1, b"".join(parts))


def stream(key: str, rows: list[list[int]], *facts: bytes) -> bytes:
    data = b"".join(struct.pack(f">{len(row)}h", *row) for row in rows)
    return nested("STRM", *facts, klv(key, "s", 2 * len(rows[0]), data))


def camera(*streams: bytes) -> bytes:
    return nested("DEVC", klv("DVID", "L", 4, bytes([0, 0, 0, 1])), *streams)


def scale(value: int) -> bytes:
    return klv("SCAL", "s", 2, struct.pack(">h", value))


def stamp(us: int) -> bytes:
    return klv("STMP", "J", 8, struct.pack(">Q", us))


def test_axes_follow_orin_and_values_the_scale() -> None:
    orin = klv("ORIN", "c", 1, b"XzY")
    data = camera(
        stream("GYRO", [[100, 200, 300], [400, 500, 600]], orin, scale(100)),
        stream("ACCL", [[10, 20, 30]], scale(10)),  # older cameras: Z, X, Y
    )
    streams = read_streams([Payload(0.0, 1.0, data)])
    assert streams["GYRO"].in_axes().tolist() == [[1.0, 3.0, -2.0], [4.0, 6.0, -5.0]]
    assert streams["ACCL"].in_axes().tolist() == [[2.0, 3.0, 1.0]]


def test_times_are_those_of_the_cameras_clock_from_the_first_image_on() -> None:
    blocks = [(1_000_000, 995_000), (2_001_000, 1_997_000)]
    payloads = [
        Payload(
            1.001 * n,
            1.001,
            camera(
                stream("SHUT", [[1]] * 30, stamp(image_us)),
                stream("GYRO", [[1, 2, 3]] * 200, stamp(gyro_us)),
            ),
        )
        for n, (image_us, gyro_us) in enumerate(blocks)
    ]
    streams = read_streams(payloads)
    stamps = streams["GYRO"].stamps_ns(streams["SHUT"])
    assert stamps[[0, 100, 200, 399]].tolist() == [-5_000_000, 496_000_000, 997_000_000, 1993990000]
    # Without a clock the payloads have the times: a line through their beginnings.
    assert streams["GYRO"].stamps_ns()[[0, 200]].tolist() == [0, 1_001_000_000]


def test_complex_elements_as_of_gps9() -> None:
    kinds = klv("TYPE", "c", 1, b"lllllllSS")
    scales = [10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1]
    row = struct.pack(">7lHH", 473000000, 85000000, 412500, 1500, 150, 8000, 43200500, 150, 3)
    facts = kinds + klv("SCAL", "l", 4, struct.pack(">9l", *scales))
    data = camera(nested("STRM", facts, klv("GPS9", "?", 32, row)))
    values = read_streams([Payload(0.0, 1.0, data)])["GPS9"].rows[0].tolist()
    assert values == [47.3, 8.5, 412.5, 1.5, 1.5, 8000.0, 43200.5, 1.5, 3.0]


def test_damaged_streams_give_what_was_before_the_damage() -> None:
    data = camera(stream("GYRO", [[1, 2, 3]] * 4, scale(1)), stream("ACCL", [[1, 2, 3]], scale(0)))
    assert list(read_streams([Payload(0.0, 1.0, data)])) == ["GYRO"]  # a scale of 0
    for length in range(len(data)):
        assert read_streams([Payload(0.0, 1.0, data[:length])]) == {}
    assert list(entries(b"\0" * 16)) == []
    rng = np.random.default_rng(1)
    for _ in range(200):
        broken = bytearray(data)
        broken[rng.integers(8, len(data))] = rng.integers(256)
        read_streams([Payload(0.0, 1.0, bytes(broken))])


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", len(body) + 8, kind) + body


def film(path: Path, payloads: list[bytes], settings: bytes = b"") -> Path:
    """An MP4 file with nothing but a track `gpmd` of a second each."""
    head = box(b"ftyp", b"mp41", bytes(4))
    offset = len(head) + 8
    numbers = struct.pack
    table = box(
        b"stbl",
        box(b"stsd", numbers(">IIII", 0, 1, 16, 0)[:12], b"gpmd"),
        box(b"stts", numbers(">IIII", 0, 1, len(payloads), 1000)),
        box(b"stsc", numbers(">IIIII", 0, 1, 1, len(payloads), 1)),
        box(
            b"stsz",
            numbers(">III", 0, 0, len(payloads)),
            *(numbers(">I", len(p)) for p in payloads),
        ),
        box(b"stco", numbers(">III", 0, 1, offset)),
    )
    header = box(b"mdhd", numbers(">IIIII", 0, 0, 0, 1000, 1000 * len(payloads)), bytes(4))
    track = box(b"trak", box(b"mdia", header, box(b"minf", table)))
    moov = box(b"moov", track, box(b"udta", box(b"GPMF", settings)))
    path.write_bytes(head + box(b"mdat", *payloads) + moov)
    return path


def test_the_track_of_an_mp4_file(tmp_path: Path) -> None:
    payloads = [camera(stream("GYRO", [[n, 2, 3]] * 4, scale(1))) for n in range(3)]
    settings = nested(
        "DEVC",
        klv("EISE", "c", 1, b"Y"),
        klv("EISA", "c", 1, b"HS Boost"),
        klv("SROT", "f", 4, struct.pack(">f", 15.5)),
    )
    path = film(tmp_path / "a.mp4", payloads, settings)
    assert [p.data for p in read_mp4(path).payloads("gpmd")] == payloads
    found = open_gopro(path)
    assert found is not None
    assert found.streams["GYRO"].rows[:, 0].tolist() == [0.0] * 4 + [1.0] * 4 + [2.0] * 4
    assert found.is_stabilised and found.text("EISA") == "HS Boost"
    assert found.readout_s == 0.0155
    assert found.cam0_from_imu is None
    data = path.read_bytes()
    for length in range(0, len(data), 7):
        path.write_bytes(data[:length])
        open_gopro(path)


@pytest.mark.parametrize(
    ("name", "count", "gyro", "accel"),
    [  # by GoPro's own parser; those of MAX after its ORIO
        ("karma.mp4", 4795, [70 / 3755, 125 / 3755, 172 / 3755], [-356 / 418, -1547 / 418]),
        ("max-heromode.mp4", 2082, [68 / 939, -146 / 939, -209 / 939], [198 / 417, 675 / 417]),
        ("hero5.raw", 399, [153 / 3755, 105 / 3755, 185 / 3755], [-76 / 418, 387 / 418]),
    ],
)
def test_gopro_samples(
    shared_data: Path, name: str, count: int, gyro: list[float], accel: list[float]
) -> None:
    found = open_gopro(shared_data / "gopro" / name)
    assert found is not None
    samples = found.imu()
    assert len(samples) <= count == len(found.streams["GYRO"].rows)
    assert found.streams["GYRO"].in_axes()[0].tolist() == gyro
    assert found.streams["ACCL"].in_axes()[0, :2].tolist() == accel
    assert np.linalg.norm(samples.accel, axis=1).mean() == pytest.approx(9.9, abs=0.2)
    assert np.diff(samples.stamps_ns).min() > 0


def test_positions_and_settings_of_gopro_samples(shared_data: Path) -> None:
    found = open_gopro(shared_data / "gopro" / "max-heromode.mp4")
    assert found is not None
    positions = found.positions()
    assert positions is not None
    assert positions.values[0].tolist() == [33.12677, -117.3273436, -22.959]
    assert positions.sigma_m[0] == pytest.approx(2 * 1.54)
    assert len(positions.stamps_ns) == 191
    assert (found.text("MINF"), found.text("EISA")) == ("GoPro Max", "HS HLevel")
    assert found.readout_s == pytest.approx(0.0206, abs=1e-4)
    raw = open_imu(shared_data / "gopro" / "Fusion.raw").read()
    assert len(raw) > 3000
