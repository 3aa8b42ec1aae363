"""Records of a ROS 1 bag: a header of named fields, followed by data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import SourceError
from vo.recordings.formats.decompression import decompress, size_limit

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_MAGIC = b"#ROSBAG V2.0\n"
_MAX_HEADER_BYTES = 2**20
_MAX_RECORD_BYTES = 2**32


class Damaged(Exception):
    """A bag is truncated, or damaged at a byte."""

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(f"{reason} (at byte {offset})")
        self.offset = offset


class Record(NamedTuple):
    """A record.

    Attributes:
        start: position of its data in the file or in the decompressed chunk.
        data: its data; empty for chunks.
    """

    fields: dict[str, bytes]
    start: int
    length: int
    data: bytes | memoryview

    @property
    def op(self) -> int:
        """Kind of record."""
        return self.number("op", 1)

    @property
    def connection(self) -> int:
        """Number of its connection."""
        return self.number("conn", 4)

    def number(self, name: str, size: int) -> int:
        """The value of an integer field of `size` bytes.

        Raises:
            Damaged: the field is missing.
        """
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise Damaged(self.start, f"a record has no {name}")
        return int.from_bytes(value, "little")

    def time(self, name: str) -> int:
        """The value of a time field in nanoseconds; raises as `number`."""
        value = self.number(name, 8)  # lower half: seconds; upper half: nanoseconds
        return (value & 0xFFFFFFFF) * 1_000_000_000 + (value >> 32)


class Connection(NamedTuple):
    """Topic, message type and message definition of a publisher."""

    topic: str
    kind: str
    definition: bytes


@dataclass
class Chunk:
    """Position of a chunk's data in the file.

    Attributes:
        size: its size when decompressed, as stated; None if it is not.
        connections: connections with messages in it; empty if unknown.
    """

    start: int
    length: int
    compression: str
    size: int | None = None
    connections: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, record: Record) -> Chunk:
        """The chunk in a record."""
        name = record.fields.get("compression", b"none").decode(errors="replace")
        stated = record.fields.get("size", b"")
        size = int.from_bytes(stated, "little") if len(stated) == 4 else None
        return cls(record.start, record.length, name, size)


def file_records(path: Path) -> Iterator[Record]:
    """Iterate over the records of the file, without those inside of chunks.

    Raises:
        SourceError: it is not a bag of version 2.0.
        Damaged: a record is truncated or invalid.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        magic = stream.read(len(_MAGIC))
        if magic != _MAGIC:
            what = "is empty" if not magic else f"begins with {magic!r}"
            raise SourceError(f"{path} {what}; a ROS 1 bag of version 2.0 begins with {_MAGIC!r}")
        while stream.tell() < size:
            at = stream.tell()
            header = stream.read(_length(stream.read(4), at, _MAX_HEADER_BYTES))
            fields = _fields(header, at)
            length = _length(stream.read(4), at, _MAX_RECORD_BYTES)
            start = stream.tell()
            record = Record(fields, start, length, b"")
            if start + length > size:
                if record.op == CHUNK:
                    yield record._replace(length=size - start)
                raise Damaged(size, "it is cut off")
            if record.op in (CONNECTION, CHUNK_INFO):
                record = record._replace(data=stream.read(length))
            else:
                stream.seek(length, 1)
            yield record


def chunk_records(data: bytes) -> Iterator[Record]:
    """Iterate over the records of a decompressed chunk.

    Raises:
        Damaged: a record is truncated or invalid.
    """
    view = memoryview(data)
    at = 0
    while at < len(data):
        header_at = at + 4
        header = view[header_at : header_at + _length(data[at : at + 4], at, _MAX_HEADER_BYTES)]
        length_at = header_at + len(header)
        length = _length(data[length_at : length_at + 4], at, len(data))
        start = length_at + 4
        if start + length > len(data):
            raise Damaged(at, "a chunk ends inside a record")
        yield Record(_fields(bytes(header), at), start, length, view[start : start + length])
        at = start + length


def connection_of(record: Record) -> Connection:
    """Parse the record of a connection.

    Raises:
        Damaged: a field is missing.
    """
    about = _fields(bytes(record.data), record.start)
    topic = record.fields.get("topic", b"").decode(errors="replace")
    kind = about.get("type", b"").decode(errors="replace")
    if not topic or not kind:
        raise Damaged(record.start, "a connection has no topic or type")
    return Connection(topic, kind, about.get("message_definition", b""))


def log_ns_of(message: Record) -> int:
    """Log time of a message."""
    return message.time("time")


def _length(four: bytes, at: int, max_length: int) -> int:
    length = int.from_bytes(four, "little")
    if len(four) < 4:
        raise Damaged(at, "it is cut off")
    if length > max_length:
        raise Damaged(at, f"invalid record length of {length} bytes")
    return length


def _fields(header: bytes, offset: int) -> dict[str, bytes]:
    fields = {}
    at = 0
    while at < len(header):
        length = int.from_bytes(header[at : at + 4], "little")
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not equals or at + 4 + length > len(header):
            raise Damaged(offset, "the header of a record is invalid")
        fields[name.decode(errors="replace")] = value
        at += 4 + length
    return fields


def load_chunk(path: Path, chunk: Chunk) -> bytes:
    """Read and decompress a chunk; of a truncated chunk, as much as possible."""
    max_bytes = size_limit(chunk.length)
    try:
        if chunk.length > max_bytes:
            raise SourceError(f"it has {chunk.length} bytes; at most {max_bytes} are read")
        with path.open("rb") as stream:
            stream.seek(chunk.start)
            data = stream.read(chunk.length)
        if chunk.compression == "none":
            return data
        if chunk.compression not in ("bz2", "lz4"):
            raise SourceError(f"it is compressed with '{chunk.compression}', not bz2 or lz4")
        if chunk.size is not None:
            max_bytes = min(max_bytes, chunk.size)
        return decompress(data, chunk.compression, max_bytes)
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
    except SourceError as error:
        raise SourceError(f"{path}: a chunk at byte {chunk.start}: {error}") from error
