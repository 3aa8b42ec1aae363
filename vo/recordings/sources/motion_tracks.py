"""Inertial sensors and positions in videos, of GoPro (see gopro.py), CAMM, Sony and Insta360.

Sources: Google, "Camera Motion Metadata Spec" (Street View Publish API); for Sony and Insta360,
    which publish none, the parsers telemetry-parser (A. Eddy) and ExifTool (P. Harvey).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.base.types import Floats, Ints
from vo.recordings.formats.mp4_boxes import Mp4, read_mp4
from vo.recordings.formats.positions import PositionTable
from vo.recordings.sources.gopro import GoPro, open_gopro
from vo.recordings.sources.imu import ImuSamples, joined_samples, make_samples

STANDARD_GRAVITY = 9.80665
_MAX_VALUE = 1e9  # of seconds, rates and accelerations
_IN_G = (0.5, 1.5)  # mean length of accelerations in g
_CAMM_GYRO, _CAMM_ACCEL, _CAMM_POINT, _CAMM_GPS = 2, 3, 5, 6
_CAMM_SHUTTER = 1
_CAMM_FLOATS = struct.Struct("<3f")
_CAMM_POINTS = struct.Struct("<3d")
_CAMM_FIX = struct.Struct("<di2d3f")  # time, fix, latitude, longitude, height, two accuracies
_SONY_HEADER, _SONY_SET, _SONY_CONTAINER = 0x1C, 0x060E, 0x8300
_SONY_ZOOM, _SONY_STABILISED = 0x8004, 0xE300
_SONY_GYRO, _SONY_ACCEL = 0xE430, 0xE440  # + 9: scale, + 10: axes, + 11: samples
_MAGIC = b"8db42d694ccc418790edff439fe026bf"  # the last bytes of a file of Insta360
_TAIL = 72  # padding, size of the trailer, version, magic
_MAX_TRAILER = 2**28
_INSTA_FACTS, _INSTA_GYRO = 1, 3
_INSTA_ROW = np.dtype([("t", "<u8"), ("accel", "<f8", 3), ("gyro", "<f8", 3)])
_INSTA_RAW_ROW = np.dtype([("t", "<u8"), ("accel", "<u2", 3), ("gyro", "<u2", 3)])


@dataclass(frozen=True, eq=False)
class MotionTrack:
    """What a camera wrote into a video beside the images.

    Attributes:
        name: of the format.
        model: of the camera, empty if it is unknown.
        imu: reads samples at times in the video; None without a sensor.
        cam0_from_imu: (4, 4) pose of the sensor; None if its axes in the image are unknown.
        positions: at times in the video.
        readout_s: time from the first to the last row of an image, 0 if it is unknown.
        stabilisation: its name, if the images were turned against the camera.
        focal_35_mm: focal length of the equivalent 35 mm camera, 0 if it is unknown.
    """

    name: str
    model: str = ""
    imu: Callable[[], ImuSamples] | None = None
    cam0_from_imu: Floats | None = None
    positions: PositionTable | None = None
    readout_s: float = 0.0
    stabilisation: str = ""
    focal_35_mm: float = 0.0


def read_motion_track(path: Path) -> MotionTrack | None:
    """The track, or the trailer, of a video; None without any."""
    gopro = open_gopro(path)
    if gopro is not None:
        return _of_gopro(gopro)
    mp4 = read_mp4(path)
    kinds = {track.kind for track in mp4.tracks}
    if "camm" in kinds:
        return _camm(mp4)
    return _sony(mp4) if "rtmd" in kinds else _insta360(path)


def _of_gopro(gopro: GoPro) -> MotionTrack:
    return MotionTrack(
        "GPMF",
        gopro.text("MINF") or "GoPro",
        gopro.imu if gopro.has_imu else None,
        gopro.cam0_from_imu,
        gopro.positions(),
        gopro.readout_s,
        (gopro.text("EISA") or "EIS") if gopro.is_stabilised else "",
    )


def _reader(gyro: list[Floats], accel: list[Floats]) -> Callable[[], ImuSamples] | None:
    """Of rows of time in seconds and three axes; accelerations in m/s² or in g."""
    turns, pulls = (_usable(rows) for rows in (gyro, accel))
    if not len(turns) or not len(pulls):
        return None
    mean = float(np.linalg.norm(pulls[:, 1:], axis=1).mean())
    pulls[:, 1:] *= STANDARD_GRAVITY if _IN_G[0] < mean < _IN_G[1] else 1.0
    samples = joined_samples(
        make_samples(_ns(turns[:, 0]).tolist(), np.pad(turns[:, 1:], ((0, 0), (0, 3))), 0),
        make_samples(_ns(pulls[:, 0]).tolist(), np.pad(pulls[:, 1:], ((0, 0), (3, 0))), 0),
    )
    return lambda: samples


def _usable(rows: list[Floats]) -> Floats:
    table = np.concatenate(rows) if rows else np.zeros((0, 4))
    return np.asarray(table[(np.abs(table) < _MAX_VALUE).all(axis=1)])


def _ns(seconds: Floats) -> Ints:
    return np.asarray(np.rint(1e9 * seconds).astype(np.int64))


def _camm(mp4: Mp4) -> MotionTrack:
    gyro: list[Floats] = []
    accel: list[Floats] = []
    places: list[tuple[float, ...]] = []
    readout_s = 0.0
    for payload in mp4.payloads("camm"):
        kind, data = int.from_bytes(payload.data[2:4], "little"), payload.data[4:]
        try:
            if kind in (_CAMM_GYRO, _CAMM_ACCEL):
                row = np.array([[payload.start_s, *_CAMM_FLOATS.unpack_from(data)]])
                (gyro if kind == _CAMM_GYRO else accel).append(row)
            elif kind == _CAMM_POINT:
                places.append((payload.start_s, *_CAMM_POINTS.unpack_from(data), np.nan))
            elif kind == _CAMM_GPS:
                _, fix, latitude, longitude, height, sigma_m, _ = _CAMM_FIX.unpack_from(data)
                if fix:
                    places.append((payload.start_s, latitude, longitude, height, sigma_m))
            elif kind == _CAMM_SHUTTER:
                readout_s = 1e-9 * struct.unpack_from("<2i", data)[1]
        except struct.error:
            continue  # a packet that is cut
    positions = None
    if places:
        table = np.array(places)
        stamps, first = np.unique(_ns(table[:, 0]), return_index=True)
        positions = PositionTable(stamps, table[first, 1:4], table[first, 4], True)
    model = " ".join(mp4.texts[key] for key in ("make", "model") if key in mp4.texts)
    imu = _reader(gyro, accel)
    return MotionTrack("CAMM", model, imu, None, positions, _readout(readout_s))


def _readout(seconds: float) -> float:
    return seconds if 0.0 < seconds < 0.1 else 0.0


def _sony(mp4: Mp4) -> MotionTrack:
    gyro: list[Floats] = []
    accel: list[Floats] = []
    stabilisation, focal_mm = "", 0.0
    for payload in mp4.payloads("rtmd"):
        tags = dict(_sony_tags(payload.data[_SONY_HEADER:]))
        focal_mm = focal_mm or _sony_focal_mm(tags.get(_SONY_ZOOM, b""))
        if any(tags.get(_SONY_STABILISED, b"")):
            stabilisation = "SteadyShot"
        for first, unit, rows in (
            (_SONY_GYRO, np.pi / 180.0, gyro),
            (_SONY_ACCEL, STANDARD_GRAVITY, accel),
        ):
            values = unit * _sony_vectors(tags, first)
            times = payload.start_s + payload.seconds * np.arange(len(values)) / max(len(values), 1)
            rows.append(np.hstack([times[:, None], values]))
    imu = _reader(gyro, accel)
    return MotionTrack("Sony", "Sony", imu, None, None, 0.0, stabilisation, focal_mm)


def _sony_focal_mm(value: bytes) -> float:
    """From metres in two bytes: an exponent of ten of four bits, and twelve of the mantissa."""
    number = int.from_bytes(value[:2], "big")
    exponent = (number >> 12 ^ 8) - 8
    return 1000.0 * (number & 0xFFF) * 10.0**exponent


def _sony_tags(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Tags of two bytes with the lengths of their values; sets and containers are opened."""
    at = 0
    while at + 4 <= len(data):
        tag, size = struct.unpack_from(">HH", data, at)
        if tag == _SONY_SET:  # the first bytes of a universal label of 16
            at += 16
            continue
        if tag in (0, 0xFFFF) or at + 4 + size > len(data):
            return
        value = data[at + 4 : at + 4 + size]
        if tag == _SONY_CONTAINER:
            yield from _sony_tags(value)
        else:
            yield tag, value
        at += 4 + size


def _sony_vectors(tags: dict[int, bytes], first: int) -> Floats:
    """(N, 3) degrees/s or g along the axes that the file names."""
    try:
        (scale,) = struct.unpack(">f", tags[first + 9])
        (axes,) = struct.unpack(">H", tags[first + 10])
        count, size = struct.unpack_from(">2i", tags[first + 11])
    except (KeyError, struct.error):
        return np.zeros((0, 3))
    codes = [axes >> shift & 15 for shift in (0, 4, 8)]  # 2 * axis, + 1 where it is reversed
    data = tags[first + 11][8:]
    if size != 6 or not scale or max(codes) > 5 or not 0 < count <= len(data) // size:
        return np.zeros((0, 3))
    raw = np.frombuffer(data, ">i2", 3 * count).reshape(-1, 3) / scale
    found = np.zeros((count, 3))
    for column, code in enumerate(codes):
        found[:, code // 2] = -raw[:, column] if code % 2 else raw[:, column]
    return found


def _insta360(path: Path) -> MotionTrack | None:
    records = _insta360_records(path)
    if _INSTA_FACTS not in records or _INSTA_GYRO not in records:
        return None
    numbers, texts = _protobuf(records[_INSTA_FACTS])
    ranges, _ = _protobuf(texts.get(65, b""))
    is_raw = bool(numbers.get(62, 0))
    layout = _INSTA_RAW_ROW if is_raw else _INSTA_ROW
    data = records[_INSTA_GYRO]
    rows = np.frombuffer(data[: len(data) // layout.itemsize * layout.itemsize], layout)
    times = (rows["t"].astype(np.float64) - numbers.get(24, 0)) * (1e-6 if is_raw else 1e-3)
    gyro, accel = rows["gyro"].astype(np.float64), rows["accel"].astype(np.float64)
    if is_raw:  # degrees/s and g in steps of 1/32768 of the range
        gyro = np.radians((gyro / 2**15 - 1.0) * (ranges.get(2, 0) or 2000))
        accel = (accel / 2**15 - 1.0) * (ranges.get(1, 0) or 16)
    readout_ms = float(np.frombuffer(texts.get(25, bytes(8))[:8].ljust(8, b"\0"), "<f8")[0])
    model = texts.get(2, b"").decode("utf-8", "replace") or "Insta360"
    imu = _reader(*([np.hstack([times[:, None], each])] for each in (gyro, accel)))
    return MotionTrack("Insta360", model, imu, readout_s=_readout(1e-3 * readout_ms))


def _insta360_records(path: Path) -> dict[int, bytes]:
    """Records of the trailer by their kind; they are listed backwards from its end."""
    records: dict[int, bytes] = {}
    try:
        with path.open("rb") as file:
            end = file.seek(0, 2)
            file.seek(max(0, end - _TAIL))
            tail = file.read(_TAIL)
            if not tail.endswith(_MAGIC) or len(tail) < _TAIL:
                return records
            (size,) = struct.unpack_from("<I", tail, 32)
            size = min(size, end, _MAX_TRAILER)
            file.seek(end - size)
            data = file.read(size)
    except OSError:
        return records
    at = len(data) - _TAIL
    while at >= 6:
        _, kind, length = struct.unpack_from("<BBI", data, at - 6)
        at -= 6 + length
        if at < 0:
            break
        records.setdefault(kind, data[at : at + length])
    return records


def _protobuf(data: bytes) -> tuple[dict[int, int], dict[int, bytes]]:
    """Fields of a message by their number: varints, and the bytes of all others."""
    numbers: dict[int, int] = {}
    texts: dict[int, bytes] = {}
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        if key & 7 == 0:
            numbers[key >> 3], at = _varint(data, at)
            continue
        size = {1: 8, 5: 4}.get(key & 7, -1)
        if key & 7 == 2:
            size, at = _varint(data, at)
        if size < 0:
            break
        texts[key >> 3], at = data[at : at + size], at + size
    return numbers, texts


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(data) and shift < 64:
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            break
    return value & 2**64 - 1, at
