"""Records of an MCAP file, and the index made of them: channels, and addresses of messages.

Source: MCAP format specification, version 0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import NamedTuple, Protocol, TypeVar, cast

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from vo.base.errors import SourceError
from vo.recordings.formats.codecs import find_codec
from vo.recordings.formats.decompression import size_limit
from vo.recordings.formats.messages import HEAD_BYTES, Codec
from vo.recordings.sources.logs.log import Entry, MessageSpan

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
MESSAGE_HEADER = struct.Struct("<HIQQ")
_CHUNK_HEADER = struct.Struct("<QQQII")
_MAX_OPCODE, _MIN_PRIVATE_OPCODE = 0x0F, 0x80
_MAX_NAME_BYTES = 16

Parsed = TypeVar("Parsed", Channel, ChunkIndex, Footer, Metadata, MetadataIndex, Schema, Statistics)
NO_CHUNK = -1
"""Chunk number of messages outside of chunks."""


class Readable(Protocol):
    """A file, or a decompressed stream."""

    def seek(self, offset: int, /) -> int: ...  # noqa: D102

    def read(self, size: int, /) -> bytes: ...  # noqa: D102


class Damaged(Exception):
    """Invalid data in a file.

    Attributes:
        offset: position in the file at which the data becomes invalid.
    """

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(reason)
        self.offset = offset


class Record(NamedTuple):
    """Opcode of a record, and position and length of its content."""

    opcode: int
    start: int
    length: int


class ChunkHeader(NamedTuple):
    """Header of a chunk; its stored data has `size` bytes and begins at `start`."""

    first_ns: int
    last_ns: int
    decompressed_size: int
    crc: int
    compression: str
    start: int
    size: int


def records_between(stream: Readable, start: int, end: int) -> Iterator[Record]:
    """Iterate over the records of a byte range; their contents are not read.

    Raises:
        Damaged: a record is invalid or exceeds the range.
    """
    position = start
    while position < end:
        stream.seek(position)
        header = stream.read(RECORD_HEADER.size)
        if len(header) < RECORD_HEADER.size:
            raise Damaged(position, "the file ends inside a record")
        opcode, length = RECORD_HEADER.unpack(header)
        if opcode == 0 or _MAX_OPCODE < opcode < _MIN_PRIVATE_OPCODE:
            raise Damaged(position, f"invalid record opcode 0x{opcode:02x}")
        if position + RECORD_HEADER.size + length > end:
            raise Damaged(position, "a record exceeds the end of the file")
        yield Record(opcode, position + RECORD_HEADER.size, length)
        position += RECORD_HEADER.size + length


def read_chunk_header(stream: Readable, start: int, end: int) -> ChunkHeader:
    """Read the header of a chunk.

    `end`: end of the content of the record; 0 if unknown.

    Raises:
        Damaged: the header is invalid, or the data exceeds a known end.
    """
    stream.seek(start)
    header = stream.read(_CHUNK_HEADER.size + _MAX_NAME_BYTES + 8)
    if len(header) < _CHUNK_HEADER.size:
        raise Damaged(start, "the file ends inside a chunk")
    first_ns, last_ns, decompressed, crc, name_size = _CHUNK_HEADER.unpack_from(header)
    after = _CHUNK_HEADER.size + name_size
    if name_size > _MAX_NAME_BYTES or len(header) < after + 8:
        raise Damaged(start, "the header of a chunk is invalid")
    compression = header[_CHUNK_HEADER.size : after].decode("ascii", "replace")
    (size,) = struct.unpack_from("<Q", header, after)
    if decompressed > size_limit(size):
        raise Damaged(start, f"a chunk of {size} bytes cannot have {decompressed}")
    if start + after + 8 + size > end and end > 0:
        raise Damaged(start, "the data of a chunk exceeds the chunk")
    return ChunkHeader(first_ns, last_ns, decompressed, crc, compression, start + after + 8, size)


def parse(kind: type[Parsed], content: bytes, offset: int) -> Parsed:
    """Parse the content of a record.

    Raises:
        Damaged: the content is invalid.
    """
    try:
        return cast(Parsed, kind.read(ReadDataStream(BytesIO(content))))
    except (McapError, struct.error, UnicodeDecodeError, MemoryError, OverflowError) as error:
        raise Damaged(offset, f"a {kind.__name__} record is invalid") from error


MESSAGE, CHUNK = int(Opcode.MESSAGE), int(Opcode.CHUNK)
SCHEMA, CHANNEL = int(Opcode.SCHEMA), int(Opcode.CHANNEL)
FOOTER, DATA_END = int(Opcode.FOOTER), int(Opcode.DATA_END)
STATISTICS, CHUNK_INDEX = int(Opcode.STATISTICS), int(Opcode.CHUNK_INDEX)
METADATA, METADATA_INDEX = int(Opcode.METADATA), int(Opcode.METADATA_INDEX)


class MessageAddress(NamedTuple):
    """Address of the data of a message: number of its chunk, first byte and length."""

    chunk: int
    start: int
    length: int


@dataclass
class MessageIndex:
    """Index built from records.

    Attributes:
        entries: messages by channel number, for channels that can be decoded.
        codecs: decoder by channel number; None for unsupported message types.
        listed: numbers of the channels whose messages are listed; None for all.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    statistics: dict[int, MessageSpan] = field(default_factory=dict)
    entries: dict[int, list[Entry]] = field(default_factory=dict)
    codecs: dict[int, Codec | None] = field(default_factory=dict)
    listed: frozenset[int] | None = None

    def add_records(
        self, stream: Readable, start: int, end: int, chunk: int, offset: int = 0
    ) -> None:
        """Add all records of a byte range.

        `chunk`: number of the chunk; `NO_CHUNK` outside of chunks.
        `offset`: position in the stream at which the data of the chunk begins.

        Raises:
            Damaged: a record is invalid; the records before it have been added.
        """
        for record in records_between(stream, start, end):
            self.add_record(stream, record, chunk, offset)

    def add_record(self, stream: Readable, record: Record, chunk: int, offset: int = 0) -> None:
        """Add a record; arguments and errors as for `add_records`."""
        if record.opcode == MESSAGE:
            self._add_message(stream, record, chunk, offset)
        elif record.opcode == SCHEMA:
            schema = parse(Schema, _content(stream, record), record.start)
            self.schemas.setdefault(schema.id, schema)
        elif record.opcode == CHANNEL:
            channel = parse(Channel, _content(stream, record), record.start)
            self.channels.setdefault(channel.id, channel)

    def codec(self, number: int) -> Codec | None:
        """The decoder of a channel, or None."""
        if number not in self.codecs:
            channel = self.channels.get(number)
            schema = None if channel is None else self.schemas.get(channel.schema_id)
            if channel is None or schema is None:
                return None
            self.codecs[number] = find_codec(
                channel.message_encoding, schema.name, schema.encoding, schema.data
            )
        return self.codecs[number]

    def _add_message(self, stream: Readable, record: Record, chunk: int, offset: int) -> None:
        stream.seek(record.start)
        header = stream.read(min(record.length, MESSAGE_HEADER.size + HEAD_BYTES))
        if len(header) < MESSAGE_HEADER.size:
            raise Damaged(record.start, f"a message of {record.length} bytes is too short")
        number, _, log_ns, _ = MESSAGE_HEADER.unpack_from(header)
        self.statistics.setdefault(number, MessageSpan()).add(log_ns)
        if self.listed is not None and number not in self.listed:
            return
        codec = self.codec(number)
        if codec is None:
            return
        try:
            stamp_ns = codec.peek_stamp_ns(header[MESSAGE_HEADER.size :])
        except SourceError:
            stamp_ns = None
        start, length = record.start + MESSAGE_HEADER.size, record.length - MESSAGE_HEADER.size
        entry = Entry(log_ns, stamp_ns, MessageAddress(chunk, start - offset, length))
        self.entries.setdefault(number, []).append(entry)


def _content(stream: Readable, record: Record) -> bytes:
    stream.seek(record.start)
    return stream.read(record.length)
