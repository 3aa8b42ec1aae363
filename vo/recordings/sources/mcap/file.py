"""MCAP files as logs; the file is open only during reads."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from vo.base.errors import SourceError
from vo.recordings.sources.logs.log import (
    NS_PER_S,
    ChunkCache,
    Entry,
    MessageSpan,
    Topic,
    UnreadTopic,
    topic_of,
    unread_topics,
)
from vo.recordings.sources.mcap.chunks import Chunk, DecompressedStream, load_chunk
from vo.recordings.sources.mcap.contents import FileContents, read_contents
from vo.recordings.sources.mcap.records import (
    NO_CHUNK,
    Damaged,
    MessageAddress,
    MessageIndex,
)

_log = logging.getLogger(__name__)


class McapFile:
    """A `Log` in an MCAP file, with or without chunks and an index, intact or damaged."""

    def __init__(self, path: Path, contents: FileContents | None = None) -> None:
        """Read the contents of the file; one without a valid summary is scanned once.

        `contents`: the contents, for a file that is still growing.
        """
        self.path = path
        try:
            self._contents = contents or read_contents(path)
        except OSError as error:
            raise read_error(path, error) from error
        chunks = self._contents.chunks
        self._cache = ChunkCache(lambda number: load_chunk(path, chunks[number]))
        self._channels_of = _channels_by_topic(self._contents.index)
        self.topics = [
            topic
            for name in sorted(self._channels_of)
            if (topic := _topic(name, self._channels_of[name], self._contents.index)) is not None
        ]
        self.unread = unread_topics(_all_topics(self._contents.index), self._channels_of)
        if contents is None:
            warn_of_damage(path, self._contents)

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """See `Log.entries`."""
        index = self._contents.index if self._contents.is_listed else self._list_messages(names)
        return {
            name: _merged([index.entries.get(number, []) for number in self._channels_of[name]])
            for name in names
        }

    def metadata(self, name: str) -> Mapping[str, str]:
        """See `Log.metadata`."""
        return self._contents.metadata.get(name, {})

    def read(self, entry: Entry) -> bytes:
        """Read the bytes of a message."""
        address: MessageAddress = entry.address
        try:
            if address.chunk == NO_CHUNK:
                with self.path.open("rb") as stream:
                    stream.seek(address.start)
                    data = stream.read(address.length)
            else:
                whole = self._cache.get(address.chunk)
                data = whole[address.start : address.start + address.length]
        except OSError as error:
            raise read_error(self.path, error) from error
        except Damaged as damage:
            raise SourceError(f"{self.path}: {damage} (at byte {damage.offset})") from damage
        if len(data) < address.length:
            raise SourceError(f"{self.path} ends inside a message")
        return data

    def _list_messages(self, names: Collection[str]) -> MessageIndex:
        """Scan the chunks that contain messages of some topics."""
        listed = frozenset(number for name in names for number in self._channels_of[name])
        summary = self._contents.index
        index = MessageIndex(
            summary.channels, summary.schemas, codecs=summary.codecs, listed=listed
        )
        try:
            with self.path.open("rb") as stream:
                for number, chunk in enumerate(self._contents.chunks):
                    if chunk.channels is None or chunk.channels & listed:
                        self._list_chunk(index, stream, number, chunk)
        except OSError as error:
            raise read_error(self.path, error) from error
        return index

    def _list_chunk(self, index: MessageIndex, stream: BinaryIO, number: int, chunk: Chunk) -> None:
        header = chunk.header
        try:
            # The checksum is verified when a message is read.
            if chunk.is_compressed:
                index.add_records(
                    DecompressedStream(stream, chunk), 0, header.decompressed_size, number
                )
            else:
                end = header.start + header.size
                index.add_records(stream, header.start, end, number, offset=header.start)
        except Damaged as damage:
            _log.warning(
                "%s: %s at byte %d: messages between %s and %s are skipped",
                self.path,
                damage,
                header.start,
                _seconds(header.first_ns),
                _seconds(header.last_ns),
            )


def _channels_by_topic(index: MessageIndex) -> dict[str, list[int]]:
    channels: dict[str, list[int]] = {}
    for number, channel in sorted(index.channels.items()):
        has_messages = number in index.statistics and index.statistics[number].count > 0
        if has_messages and index.codec(number) is not None:
            channels.setdefault(channel.topic, []).append(number)
    return channels


def _all_topics(index: MessageIndex) -> Iterator[UnreadTopic]:
    for number, channel in sorted(index.channels.items()):
        schema = index.schemas.get(channel.schema_id)
        kind = channel.message_encoding if schema is None else schema.name
        count = index.statistics.get(number, MessageSpan()).count
        yield UnreadTopic(channel.topic, kind, count)


def _topic(name: str, numbers: list[int], index: MessageIndex) -> Topic | None:
    """A topic of one or more channels; the first determines its schema."""
    codec = index.codec(numbers[0])
    if codec is None:
        return None
    schema = index.schemas[index.channels[numbers[0]].schema_id].name
    return topic_of(name, schema, codec, [index.statistics[number] for number in numbers])


def _merged(lists: list[list[Entry]]) -> list[Entry]:
    if len(lists) == 1:
        return lists[0]
    return sorted((entry for entries in lists for entry in entries), key=lambda e: e.log_ns)


def warn_of_damage(path: Path, contents: FileContents) -> None:
    """Warn of the unused part of a damaged file."""
    if contents.damage is not None:
        size = path.stat().st_size
        statistics = contents.index.statistics.values()
        count = sum(each.count for each in statistics)
        span_ns = max((t.last_ns for t in statistics), default=0) - min(
            (t.first_ns for t in statistics), default=0
        )
        _log.warning(
            "%s is cut off or damaged at byte %d of %d (%s); readable: %d messages in %.1f s, "
            "%.1f %% of the bytes",
            path,
            contents.damage.offset,
            size,
            contents.damage,
            count,
            span_ns / NS_PER_S if count else 0.0,
            100.0 * contents.end / size,
        )
    if contents.damaged_chunks:
        _log.warning(
            "%s: %d of %d chunks are damaged and skipped",
            path,
            contents.damaged_chunks,
            max(len(contents.chunks), contents.damaged_chunks),
        )


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // NS_PER_S}.{stamp_ns % NS_PER_S:09d} s"


def read_error(path: Path, error: OSError) -> SourceError:
    """The error for a file that the operating system cannot read."""
    return SourceError(f"{path} cannot be read: {error.strerror or error}")
