"""The records that an MCAP file is made of: where they are, and what those we need say.

Source: MCAP format specification, version 0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import NamedTuple, Protocol, TypeVar, cast

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_LARGEST_KNOWN, _FIRST_PRIVATE = 0x0F, 0x80
_LONGEST_NAME = 16
_MOST_BYTES = 4 * 2**30

Parsed = TypeVar("Parsed", Channel, ChunkIndex, Footer, Schema, Statistics)


class Readable(Protocol):
    """A file, or what unpacks like one."""

    def seek(self, offset: int, /) -> int: ...  # noqa: D102

    def read(self, size: int, /) -> bytes: ...  # noqa: D102


class Damaged(Exception):
    """What is stored cannot be true.

    Attributes:
        offset: in the file, from where on it makes no sense.
    """

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(reason)
        self.offset = offset


class Record(NamedTuple):
    """Where a record is: its opcode, and start and length of its content."""

    opcode: int
    start: int
    length: int


class ChunkHead(NamedTuple):
    """What a chunk says of itself; its data lies at `start`, `size` bytes of it as stored."""

    first_ns: int
    last_ns: int
    unpacked_size: int
    crc: int
    compression: str
    start: int
    size: int


def records_between(stream: Readable, start: int, end: int) -> Iterator[Record]:
    """The records from a position on; contents are not read.

    Raises:
        Damaged: at a record that cannot be one or that goes beyond the end.
    """
    position = start
    while position < end:
        stream.seek(position)
        head = stream.read(HEAD.size)
        if len(head) < HEAD.size:
            raise Damaged(position, "the file ends inside a record")
        opcode, length = HEAD.unpack(head)
        if opcode == 0 or _LARGEST_KNOWN < opcode < _FIRST_PRIVATE:
            raise Damaged(position, f"0x{opcode:02x} is no kind of record")
        if position + HEAD.size + length > end:
            raise Damaged(position, "a record goes beyond the end of the file")
        yield Record(opcode, position + HEAD.size, length)
        position += HEAD.size + length


def read_chunk_head(stream: Readable, start: int, end: int) -> ChunkHead:
    """What stands before the data of a chunk.

    Args:
        stream: the file.
        start: of the content of the record.
        end: of the content of the record.

    Raises:
        Damaged: it cannot be true; data that goes beyond the end is not checked for.
    """
    stream.seek(start)
    head = stream.read(_CHUNK_HEAD.size + _LONGEST_NAME + 8)
    if len(head) < _CHUNK_HEAD.size:
        raise Damaged(start, "the file ends inside a chunk")
    first_ns, last_ns, unpacked, crc, name_size = _CHUNK_HEAD.unpack_from(head)
    after = _CHUNK_HEAD.size + name_size
    if name_size > _LONGEST_NAME or unpacked > _MOST_BYTES or len(head) < after + 8:
        raise Damaged(start, "a chunk's head makes no sense")
    compression = head[_CHUNK_HEAD.size : after].decode("ascii", "replace")
    (size,) = struct.unpack_from("<Q", head, after)
    if start + after + 8 + size > end and end > 0:
        raise Damaged(start, "a chunk's data is longer than the chunk")
    return ChunkHead(first_ns, last_ns, unpacked, crc, compression, start + after + 8, size)


def parse(kind: type[Parsed], content: bytes, offset: int) -> Parsed:
    """A record from its content.

    Raises:
        Damaged: it cannot be one.
    """
    try:
        return cast(Parsed, kind.read(ReadDataStream(BytesIO(content))))
    except (McapError, struct.error, UnicodeDecodeError, MemoryError, OverflowError) as error:
        raise Damaged(offset, f"a {kind.__name__} record makes no sense") from error


MESSAGE, CHUNK = int(Opcode.MESSAGE), int(Opcode.CHUNK)
SCHEMA, CHANNEL = int(Opcode.SCHEMA), int(Opcode.CHANNEL)
FOOTER, DATA_END = int(Opcode.FOOTER), int(Opcode.DATA_END)
STATISTICS, CHUNK_INDEX = int(Opcode.STATISTICS), int(Opcode.CHUNK_INDEX)
