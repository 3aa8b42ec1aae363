"""Map files: stored keyframes, where they are placed, and the loops between them.

docs/map-format.md describes the layout. Every part has a checksum, the index is at the end, and
each keyframe is read alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np

from vo.base.errors import OutputError, SourceError
from vo.base.files.bounded_files import open_regular
from vo.base.files.bounded_json import load_json
from vo.base.files.complete_file import complete_file
from vo.base.types import Camera
from vo.engine.maps.checks import (
    MAX_NUMBER,
    check_covariances,
    check_place,
    check_poses,
    ideal_camera,
    listed,
    number,
    text,
)
from vo.engine.maps.markers import MARKERS_VERSION, decode_markers, encode_markers
from vo.engine.places.encoding import decode_place
from vo.engine.places.records import Loop, MarkerVisit, Place, PlaceKey, RegisteredKeyframes

_MAGIC = b"vo-map\r\n"
_VERSION = 1
_HEAD = struct.Struct("<8sI4x")
_TAIL = struct.Struct("<QQ32s8s")  # offset, length and SHA-256 of the index
_MAX_INDEX_BYTES = 2**30
_MAX_VALUES = 10_000  # of an index, besides those that keyframes of the file's size can have
_PLACEMENT = np.dtype(
    [
        ("world", "<i8"),
        ("world_from_cam", "<f8", (4, 4)),
        ("scale", "<f8"),
        ("covariance", "<f8", (6, 6)),
    ]
)
_LOOP = np.dtype(
    [
        ("earlier", "<i8", 2),
        ("later", "<i8", 2),
        ("earlier_from_later", "<f8", (4, 4)),
        ("scale", "<f8"),
        ("covariance", "<f8", (7, 7)),
        ("inliers", "<i8"),
    ]
)


@dataclass(frozen=True)
class MapHeader:
    """Description of a map.

    Attributes:
        camera: the rectified camera 0 of the last session, whose pixels those of keyframes are.
        vocabulary: id of the vocabulary by which loops were found.
        sessions: names of the recordings, by number of their session.
        metric_worlds: numbers of the worlds of one camera whose lengths are metres.
    """

    camera: Camera
    vocabulary: str
    sessions: tuple[str, ...]
    metric_worlds: tuple[int, ...] = ()


def write_map(
    path: Path,
    header: MapHeader,
    keyframes: Iterable[tuple[PlaceKey, bytes]],
    registered: RegisteredKeyframes,
    loops: Iterable[Loop] = (),
    markers: Sequence[MarkerVisit] = (),
) -> None:
    """Write a map; an existing file is replaced when the new one is complete and on disk.

    Keyframes are keys and bytes (`KeyframeDatabase.encoded`), all of them placed; those that are
    placed but not written are left out. Markers are relative to keyframes that are written.

    Raises:
        OutputError: the file cannot be written; one that was there is as before.
    """
    try:
        with complete_file(path) as file:
            _write(file, header, keyframes, registered, loops, markers)
    except OSError as error:
        raise OutputError(f"cannot write the map {path}: {error.strerror}") from error


def _write(
    file: BinaryIO,
    header: MapHeader,
    keyframes: Iterable[tuple[PlaceKey, bytes]],
    registered: RegisteredKeyframes,
    loops: Iterable[Loop],
    markers: Sequence[MarkerVisit],
) -> None:
    file.write(_HEAD.pack(_MAGIC, _VERSION))
    row_of = {key: n for n, key in enumerate(registered.keys)}
    rows, listed = [], []
    for key, data in keyframes:
        rows.append(row_of[key])
        listed.append([*key, *_write_part(file, data)])
    placements = np.zeros(len(rows), _PLACEMENT)
    for name in _PLACEMENT.names or ():
        placements[name] = getattr(registered, name)[rows]
    table = [tuple(getattr(loop, name) for name in _LOOP.names or ()) for loop in loops]
    index: dict[str, Any] = {
        "camera": {k: v for k, v in asdict(header.camera).items() if k != "readout_s"},
        "vocabulary": header.vocabulary,
        "sessions": list(header.sessions),
        "metric_worlds": list(header.metric_worlds),
        "keyframes": listed,
        "placements": _write_part(file, placements.tobytes()),
        "loops": _write_part(file, np.array(table, _LOOP).tobytes()),
    }
    if markers:
        description, rows_of_markers = encode_markers(markers)
        index["markers"] = {**description, "rows": _write_part(file, rows_of_markers)}
    data = json.dumps(index, separators=(",", ":")).encode()
    begin = file.tell()
    file.write(data + _TAIL.pack(begin, len(data), hashlib.sha256(data).digest(), _MAGIC))


def _write_part(file: BinaryIO, data: bytes) -> list[int]:
    """Offset, length and CRC-32 of what is written."""
    begin = file.tell()
    file.write(data)
    return [begin, len(data), zlib.crc32(data)]


class MapFile:
    """A map that is open for reading; keyframes are read on request.

    Raises:
        SourceError: it is missing, something else, damaged, or of a newer version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = open_regular(path)
        except OSError as error:
            raise SourceError(f"cannot read the map {path}: {error.strerror}") from error
        try:
            self._read_index()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def keys(self) -> tuple[PlaceKey, ...]:
        """Keys of the keyframes, in the order of the file."""
        return tuple(self._parts)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def encoded(self, key: PlaceKey) -> bytes:
        """A keyframe as bytes.

        Raises:
            KeyError: it is not in the map.
            SourceError: it is damaged.
        """
        return self._read(self._parts[key])

    def place(self, key: PlaceKey) -> Place:
        """A keyframe; errors as for `encoded`."""
        try:
            place = decode_place(self.encoded(key))
            check_place(place)
        except ValueError as error:
            raise self._damaged() from error
        if place.key != key:
            raise self._damaged()
        return place

    def _read_index(self) -> None:
        size = os.fstat(self._file.fileno()).st_size
        head = self._file.read(_HEAD.size)
        if len(head) < _HEAD.size or not head.startswith(_MAGIC):
            raise SourceError(f"{self.path} is no map; make one with `vo run --save-map FILE`")
        _, version = _HEAD.unpack(head)
        if version > _VERSION:
            raise SourceError(
                f"{self.path} is a map of version {version}, this vo reads {_VERSION}; update vo"
            )
        if size < _HEAD.size + _TAIL.size:
            raise self._damaged()
        self._file.seek(size - _TAIL.size)
        begin, length, digest, magic = _TAIL.unpack(self._file.read(_TAIL.size))
        if magic != _MAGIC or begin + length + _TAIL.size != size or length > _MAX_INDEX_BYTES:
            raise self._damaged()
        self._end = begin
        self._file.seek(begin)
        data = self._file.read(length)
        # Values take far more memory than text, and each keyframe has five besides its own bytes.
        if hashlib.sha256(data).digest() != digest or data.count(b",") > _MAX_VALUES + begin // 32:
            raise self._damaged()
        try:
            self._take(load_json(data))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise self._damaged() from error

    def _take(self, index: dict[str, Any]) -> None:
        self.header = MapHeader(
            ideal_camera(index["camera"]),
            text(index["vocabulary"]),
            tuple(map(text, listed(index["sessions"]))),
            tuple(map(number, listed(index.get("metric_worlds", [])))),
        )
        self._parts = {PlaceKey(number(s), number(k)): p for s, k, *p in index["keyframes"]}
        if any(key.session >= len(self.header.sessions) for key in self._parts):
            raise ValueError("a keyframe is of an unknown session")
        placements = np.frombuffer(self._read(index["placements"]), _PLACEMENT)
        if len(placements) != len(self._parts):
            raise ValueError("keyframes without placement")
        check_poses(placements["world_from_cam"], placements["scale"])
        covariance = placements["covariance"]
        check_covariances(covariance[~np.isnan(covariance).all(axis=(1, 2))])
        table = np.frombuffer(self._read(index["loops"]), _LOOP)
        check_poses(table["earlier_from_later"], table["scale"])
        check_covariances(table["covariance"])
        for numbers in (placements["world"], table["earlier"], table["later"]):
            if not ((numbers >= 0) & (numbers <= MAX_NUMBER)).all():
                raise ValueError("a number of a world, session or keyframe is impossible")
        self.placed = RegisteredKeyframes(
            keys=tuple(self._parts),
            rejected=(),
            wrong=(),
            **{name: placements[name].copy() for name in _PLACEMENT.names or ()},
        )
        self.loops = tuple(
            Loop(
                PlaceKey(*row["earlier"].tolist()),
                PlaceKey(*row["later"].tolist()),
                row["earlier_from_later"].copy(),
                float(row["scale"]),
                row["covariance"].copy(),
                int(row["inliers"]),
            )
            for row in table
        )

        self.markers = self._markers(index.get("markers"))

    def _markers(self, section: Any) -> tuple[MarkerVisit, ...]:
        """The markers of the index, none in a map without them."""
        if section is None:
            return ()
        version = number(section["version"])
        if version > MARKERS_VERSION:
            raise SourceError(
                f"{self.path} has markers of version {version}, this vo reads {MARKERS_VERSION}; "
                "update vo"
            )
        return decode_markers(section, self._read(section["rows"]), self._parts.keys())

    def _read(self, part: Any) -> bytes:
        begin, length, checksum = part
        if not (type(begin) is type(length) is int and 0 <= begin <= begin + length <= self._end):
            raise self._damaged()
        self._file.seek(begin)
        data = self._file.read(length)
        if len(data) != length or zlib.crc32(data) != checksum:
            raise self._damaged()
        return data

    def _damaged(self) -> SourceError:
        return SourceError(
            f"the map {self.path} is damaged or cut off; use a copy, or make it anew"
        )
