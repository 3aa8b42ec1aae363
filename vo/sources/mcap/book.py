"""What is found while going through the records of an MCAP file: channels, counts, messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.records import Channel, Schema

from vo.errors import SourceError
from vo.formats.codecs import find_codec
from vo.formats.messages import HEAD_BYTES, Codec
from vo.sources.logs.log import Entry
from vo.sources.mcap.records import (
    CHANNEL,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    Damaged,
    Readable,
    Record,
    parse,
    records_between,
)

IN_FILE = -1
"""Number of the chunk of messages that are in none."""


class Place(NamedTuple):
    """Where the data of a message is: in which chunk, and from which byte on how many."""

    chunk: int
    start: int
    length: int


@dataclass
class Tally:
    """How many messages a channel has, and when they were logged."""

    count: int = 0
    first_ns: int = 2**63
    last_ns: int = 0

    def note(self, log_ns: int) -> None:
        """Count a message."""
        self.count += 1
        self.first_ns = min(self.first_ns, log_ns)
        self.last_ns = max(self.last_ns, log_ns)


@dataclass
class Book:
    """Grows with every record.

    Attributes:
        channels: by number.
        schemas: by number.
        tallies: by channel.
        entries: messages by channel, of those channels that can be read.
        codecs: who reads the messages of a channel; None where nobody does.
        wanted: channels whose messages are listed; None for all that can be read.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    tallies: dict[int, Tally] = field(default_factory=dict)
    entries: dict[int, list[Entry]] = field(default_factory=dict)
    codecs: dict[int, Codec | None] = field(default_factory=dict)
    wanted: frozenset[int] | None = None

    def go_through(
        self, stream: Readable, start: int, end: int, chunk: int, offset: int = 0
    ) -> None:
        """Note all records of a stretch.

        Args:
            stream: the file, or the unpacked data of a chunk.
            start: of the stretch.
            end: of the stretch.
            chunk: number of the chunk that it is; `IN_FILE` outside of chunks.
            offset: of the stream where the chunk's data begins.

        Raises:
            Damaged: at a record that makes no sense; those before are noted.
        """
        for record in records_between(stream, start, end):
            self.note(stream, record, chunk, offset)

    def note(self, stream: Readable, record: Record, chunk: int, offset: int = 0) -> None:
        """Note a record; else as `go_through`."""
        if record.opcode == MESSAGE:
            self._note_message(stream, record, chunk, offset)
        elif record.opcode == SCHEMA:
            schema = parse(Schema, _content(stream, record), record.start)
            self.schemas.setdefault(schema.id, schema)
        elif record.opcode == CHANNEL:
            channel = parse(Channel, _content(stream, record), record.start)
            self.channels.setdefault(channel.id, channel)

    def codec(self, number: int) -> Codec | None:
        """Who reads the messages of a channel."""
        if number not in self.codecs:
            channel = self.channels.get(number)
            schema = None if channel is None else self.schemas.get(channel.schema_id)
            if channel is None or schema is None:
                return None
            self.codecs[number] = find_codec(
                channel.message_encoding, schema.name, schema.encoding, schema.data
            )
        return self.codecs[number]

    def _note_message(self, stream: Readable, record: Record, chunk: int, offset: int) -> None:
        stream.seek(record.start)
        head = stream.read(min(record.length, MESSAGE_HEAD.size + HEAD_BYTES))
        if len(head) < MESSAGE_HEAD.size:
            raise Damaged(record.start, f"a message of {record.length} bytes is too short")
        number, _, log_ns, _ = MESSAGE_HEAD.unpack_from(head)
        self.tallies.setdefault(number, Tally()).note(log_ns)
        if self.wanted is not None and number not in self.wanted:
            return
        codec = self.codec(number)
        if codec is None:
            return
        try:
            stamp_ns = codec.peek_stamp_ns(head[MESSAGE_HEAD.size :])
        except SourceError:
            stamp_ns = None
        start, length = record.start + MESSAGE_HEAD.size, record.length - MESSAGE_HEAD.size
        entry = Entry(log_ns, stamp_ns, Place(chunk, start - offset, length))
        self.entries.setdefault(number, []).append(entry)


def _content(stream: Readable, record: Record) -> bytes:
    stream.seek(record.start)
    return stream.read(record.length)
