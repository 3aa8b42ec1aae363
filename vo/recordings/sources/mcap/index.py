"""Index of an MCAP file: channels, their statistics, and the addresses of their messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.records import Channel, Schema

from vo.base.errors import SourceError
from vo.recordings.formats.codecs import find_codec
from vo.recordings.formats.messages import HEAD_BYTES, Codec
from vo.recordings.sources.logs.log import Entry
from vo.recordings.sources.mcap.records import (
    CHANNEL,
    MESSAGE,
    MESSAGE_HEADER,
    SCHEMA,
    Damaged,
    Readable,
    Record,
    parse,
    records_between,
)

NO_CHUNK = -1
"""Chunk number of messages outside of chunks."""


class MessageAddress(NamedTuple):
    """Address of the data of a message: number of its chunk, first byte and length."""

    chunk: int
    start: int
    length: int


@dataclass
class ChannelStatistics:
    """Number of messages of a channel, and range of their log times."""

    count: int = 0
    first_ns: int = 2**63
    last_ns: int = 0

    def add(self, log_ns: int) -> None:
        """Add a message."""
        self.count += 1
        self.first_ns = min(self.first_ns, log_ns)
        self.last_ns = max(self.last_ns, log_ns)


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
    statistics: dict[int, ChannelStatistics] = field(default_factory=dict)
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
        self.statistics.setdefault(number, ChannelStatistics()).add(log_ns)
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
