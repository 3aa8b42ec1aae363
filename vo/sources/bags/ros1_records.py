"""The records of a ROS 1 bag: headers of named fields, followed by data."""

from __future__ import annotations

import bz2
import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import lz4.frame

from vo.errors import SourceError

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_MAGIC = b"#ROSBAG V2.0\n"
_KEPT_BYTES = 64 * 2**20
_FEWEST_KEPT = 2  # left and right may be in chunks of their own
_LONGEST_HEADER = 2**20
_LONGEST_RECORD = 2**32


class Cut(Exception):
    """The bag ends, or makes no sense, at a byte."""

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(f"{reason} (at byte {offset})")
        self.offset = offset


class Record(NamedTuple):
    """A record.

    Attributes:
        fields: of its header, by name.
        start: of its data: in the file, or in the unpacked chunk.
        length: of its data.
        data: its data; empty for the data of chunks.
    """

    fields: dict[str, bytes]
    start: int
    length: int
    data: bytes | memoryview

    @property
    def op(self) -> int:
        """What kind of record it is."""
        return self.number("op", 1)

    @property
    def connection(self) -> int:
        """Number of the connection that it belongs to."""
        return self.number("conn", 4)

    def number(self, name: str, size: int) -> int:
        """A field that is a number of so many bytes.

        Raises:
            Cut: there is none.
        """
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise Cut(self.start, f"a record has no {name}")
        return int.from_bytes(value, "little")

    def time(self, name: str) -> int:
        """A field that is a time, in nanoseconds; else as `number`."""
        both = self.number(name, 8)
        return (both & 0xFFFFFFFF) * 1_000_000_000 + (both >> 32)


class Connection(NamedTuple):
    """What a publisher says of its messages."""

    topic: str
    kind: str
    definition: bytes


@dataclass
class Chunk:
    """Where a chunk's data is in the file.

    Attributes:
        start: its first byte.
        length: as stored.
        compression: `none`, `bz2` or `lz4`.
        connections: those that have messages in it; empty where nobody says.
    """

    start: int
    length: int
    compression: str
    connections: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, record: Record) -> Chunk:
        """The chunk that a record is."""
        name = record.fields.get("compression", b"none").decode(errors="replace")
        return cls(record.start, record.length, name)


class ChunkCache:
    """The chunks that were used last, unpacked, for several threads."""

    def __init__(self, path: Path, chunks: list[Chunk]) -> None:
        self._path = path
        self._chunks = chunks
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, bytes] = OrderedDict()

    def get(self, number: int) -> bytes:
        """The records in a chunk.

        Raises:
            SourceError: it cannot be read or unpacked.
        """
        with self._lock:
            data = self._kept.get(number)
            if data is None:
                data = _unpack(self._path, self._chunks[number])
                self._kept[number] = data
            self._kept.move_to_end(number)
            size = sum(len(kept) for kept in self._kept.values())
            while size > _KEPT_BYTES and len(self._kept) > _FEWEST_KEPT:
                size -= len(self._kept.popitem(last=False)[1])
        return data


def top_level(path: Path) -> Iterator[Record]:
    """The records of the file itself; those inside of chunks are left out.

    Raises:
        SourceError: it is no bag of version 2.0.
        Cut: the file ends in a record, or makes no sense from there on.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        magic = stream.read(len(_MAGIC))
        if magic != _MAGIC:
            what = "is empty" if not magic else f"begins with {magic!r}"
            raise SourceError(f"{path} {what}; a ROS 1 bag of version 2.0 begins with {_MAGIC!r}")
        while stream.tell() < size:
            at = stream.tell()
            header = stream.read(_length(stream.read(4), at, _LONGEST_HEADER))
            fields = _fields(header, at)
            length = _length(stream.read(4), at, _LONGEST_RECORD)
            start = stream.tell()
            record = Record(fields, start, length, b"")
            if start + length > size:
                if record.op == CHUNK:
                    yield record._replace(length=size - start)
                raise Cut(size, "it is cut off")
            if record.op in (CONNECTION, CHUNK_INFO):
                record = record._replace(data=stream.read(length))
            else:
                stream.seek(length, 1)
            yield record


def records_of(data: bytes) -> Iterator[Record]:
    """The records in an unpacked chunk.

    Raises:
        Cut: it ends in a record, or makes no sense from there on.
    """
    view = memoryview(data)
    at = 0
    while at < len(data):
        header_at = at + 4
        header = view[header_at : header_at + _length(data[at : at + 4], at, _LONGEST_HEADER)]
        length_at = header_at + len(header)
        length = _length(data[length_at : length_at + 4], at, len(data))
        start = length_at + 4
        if start + length > len(data):
            raise Cut(at, "a chunk ends inside a record")
        yield Record(_fields(bytes(header), at), start, length, view[start : start + length])
        at = start + length


def connection_of(record: Record) -> Connection:
    """What a record of a connection says.

    Raises:
        Cut: a field is missing.
    """
    about = _fields(bytes(record.data), record.start)
    topic = record.fields.get("topic", b"").decode(errors="replace")
    kind = about.get("type", b"").decode(errors="replace")
    if not topic or not kind:
        raise Cut(record.start, "a connection has no topic or type")
    return Connection(topic, kind, about.get("message_definition", b""))


def log_ns_of(message: Record) -> int:
    """When a message was written down."""
    return message.time("time")


def _length(four: bytes, at: int, most: int) -> int:
    length = int.from_bytes(four, "little")
    if len(four) < 4:
        raise Cut(at, "it is cut off")
    if length > most:
        raise Cut(at, f"a record of {length} bytes makes no sense")
    return length


def _fields(header: bytes, offset: int) -> dict[str, bytes]:
    fields = {}
    at = 0
    while at < len(header):
        length = int.from_bytes(header[at : at + 4], "little")
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not equals or at + 4 + length > len(header):
            raise Cut(offset, "the header of a record makes no sense")
        fields[name.decode(errors="replace")] = value
        at += 4 + length
    return fields


def _unpack(path: Path, chunk: Chunk) -> bytes:
    """The data of a chunk; of one that is cut off, as far as it goes."""
    try:
        with path.open("rb") as stream:
            stream.seek(chunk.start)
            data = stream.read(chunk.length)
        if chunk.compression == "none":
            return data
        if chunk.compression == "bz2":
            return bz2.BZ2Decompressor().decompress(data)
        if chunk.compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))
    except (OSError, RuntimeError, ValueError, EOFError) as error:
        raise SourceError(f"{path}: a chunk cannot be unpacked: {error}") from error
    raise SourceError(f"{path}: a chunk is packed with '{chunk.compression}', not bz2 or lz4")
