"""Boxes of MP4 and MOV files: tracks that are no video, and what the camera says of itself.

Source: ISO/IEC 14496-12, sections 4.2 and 8; Apple, QuickTime File Format, "Metadata".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from vo.base.frozen import frozen

_CONTAINERS = (b"trak", b"mdia", b"minf", b"stbl")
_MAX_MOOV_BYTES = 256 * 2**20
_MAX_SAMPLES, _MAX_SAMPLE_BYTES = 1_000_000, 2**24
_FULL = 8  # bytes of version, flags and count before the entries of a table


class Payload(NamedTuple):
    """A sample of a track: its time from the beginning of the film in seconds, and its bytes."""

    start_s: float
    seconds: float
    data: bytes


@dataclass
class _Track:
    kind: str = ""
    per_s: int = 1
    tables: dict[bytes, bytes] = field(default_factory=dict)


@frozen()
class Mp4:
    """The description of a film.

    Attributes:
        tracks: kind of each as its sample description has it, such as `avc1` or `gpmd`.
        texts: `make`, `model`, and all keys of Apple's metadata.
        user_data: content of the boxes in `udta`.
    """

    path: Path
    tracks: tuple[_Track, ...] = ()
    texts: dict[str, str] = field(default_factory=dict)
    user_data: dict[bytes, bytes] = field(default_factory=dict)

    def payloads(self, kind: str) -> list[Payload]:
        """The samples of the first track of a kind; those that the file lacks are left out."""
        track = next((each for each in self.tracks if each.kind == kind), None)
        if track is None:
            return []
        found = []
        try:
            with self.path.open("rb") as file:
                for start, ticks, offset, size in _samples(track):
                    file.seek(offset)
                    data = file.read(min(size, _MAX_SAMPLE_BYTES))
                    if len(data) == size:
                        found.append(Payload(start / track.per_s, ticks / track.per_s, data))
        except (OSError, struct.error, KeyError, IndexError):
            pass  # what was read before the damage
        return found


def read_mp4(path: Path) -> Mp4:
    """Read the description of a film; an empty one of a file that is none, or is damaged."""
    try:
        with path.open("rb") as file:
            moov = _moov(file)
    except (OSError, struct.error):
        moov = b""
    tracks: list[_Track] = []
    texts: dict[str, str] = {}
    user_data: dict[bytes, bytes] = {}
    try:
        for kind, body in child_boxes(moov):
            if kind == b"trak":
                tracks.append(_track(body))
                texts |= _apple_texts(tracks[-1].tables.get(b"meta", b""))
            elif kind == b"udta":
                user_data |= dict(child_boxes(body))
                texts |= _apple_texts(user_data.get(b"meta", b""))  # as FFmpeg copies them
            elif kind == b"meta":
                texts |= _apple_texts(body)
    except (struct.error, IndexError):
        pass  # what was read before the damage
    for name, key in (("make", b"\xa9mak"), ("model", b"\xa9mod")):
        if key in user_data:
            texts.setdefault(name, _text(user_data[key][4:]))
    return Mp4(path, tuple(tracks), texts, user_data)


def _moov(file: BinaryIO) -> bytes:
    """The content of the box that describes the film."""
    file.seek(0, 2)
    end, at = file.tell(), 0
    while at + 8 <= end:
        file.seek(at)
        size, kind = struct.unpack(">I4s", file.read(8))
        head = 8
        if size == 1:
            (size,), head = struct.unpack(">Q", file.read(8)), 16
        size = end - at if size == 0 else size
        if size < head:
            break
        if kind == b"moov":
            return file.read(size - head) if size < _MAX_MOOV_BYTES else b""
        at += size
    return b""


def child_boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kinds and contents of the boxes in one."""
    at = 0
    while at + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        if size < 8:
            return
        yield kind, data[at + 8 : at + size]
        at += size


def _track(data: bytes) -> _Track:
    track = _Track()
    pending = [data]
    while pending:
        for kind, body in child_boxes(pending.pop()):
            if kind in _CONTAINERS:
                pending.append(body)
            elif kind == b"mdhd":
                (track.per_s,) = struct.unpack_from(">I", body, 20 if body[0] else 12)
            else:
                track.tables[kind] = body
    track.kind = track.tables.get(b"stsd", b"")[12:16].decode("latin-1")
    track.per_s = max(track.per_s, 1)
    return track


def _samples(track: _Track) -> Iterator[tuple[int, int, int, int]]:
    """Start and length in ticks, offset and size of each sample."""
    tables = track.tables
    constant, count = struct.unpack_from(">II", tables[b"stsz"], 4)
    count = min(count, _MAX_SAMPLES)
    sizes = (constant,) * count
    if not constant:
        sizes = struct.unpack_from(f">{count}I", tables[b"stsz"], 12)
    wide = b"co64" in tables
    chunks = _table(tables[b"co64" if wide else b"stco"], "Q" if wide else "I")
    per_chunk = _table(tables[b"stsc"], "III")
    lengths = [n for times, n in _table(tables[b"stts"], "II") for n in [n] * min(times, count)]
    number = start = row = 0
    for chunk, (offset,) in enumerate(chunks, start=1):
        while row + 1 < len(per_chunk) and per_chunk[row + 1][0] <= chunk:
            row += 1
        for _ in range(min(per_chunk[row][1], count - number)):
            ticks = lengths[min(number, len(lengths) - 1)]
            yield start, ticks, offset, sizes[number]
            number, start, offset = number + 1, start + ticks, offset + sizes[number]


def _table(body: bytes, row: str) -> list[tuple[int, ...]]:
    """The entries of a table behind its version, flags and count."""
    (count,) = struct.unpack_from(">I", body, 4)
    size = struct.calcsize(f">{row}")
    count = min(count, (len(body) - _FULL) // size)
    return list(struct.iter_unpack(f">{row}", body[_FULL : _FULL + count * size]))


def _apple_texts(body: bytes) -> dict[str, str]:
    """Keys and texts of a box `meta` of QuickTime."""
    inside = dict(child_boxes(body)) or {}
    if b"keys" not in inside or b"ilst" not in inside:
        inside = dict(child_boxes(body[4:]))  # as in MP4, with version and flags
    names = [name for _, name in child_boxes(inside.get(b"keys", b"")[_FULL:])]
    texts = {}
    for number, item in child_boxes(inside.get(b"ilst", b"")):
        row = int.from_bytes(number, "big") - 1
        value = dict(child_boxes(item)).get(b"data", b"")
        if 0 <= row < len(names):
            name = _text(names[row]).removeprefix("com.apple.quicktime.")
            is_text = value[:4] == b"\0\0\0\1"
            texts[name] = _text(value[8:]) if is_text else str(int.from_bytes(value[8:16], "big"))
    return texts


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode("utf-8", "replace").strip()
