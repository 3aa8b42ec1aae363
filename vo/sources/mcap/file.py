"""An MCAP file as a log; it is open only while something is read from it."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path
from typing import BinaryIO

from vo.errors import SourceError
from vo.sources.logs.log import NS_PER_S, Entry, Topic, UnreadTopic
from vo.sources.mcap.book import IN_FILE, Book, Place
from vo.sources.mcap.chunks import Chunk, ChunkCache, UnpackedStream
from vo.sources.mcap.records import Damaged
from vo.sources.mcap.survey import Survey, survey

_log = logging.getLogger(__name__)


class McapFile:
    """A `Log` in an MCAP file, chunked or not, with an index or without, whole or damaged."""

    def __init__(self, path: Path, found: Survey | None = None) -> None:
        """Find out what is where; a file without a sound index is gone through once.

        Args:
            path: the file.
            found: what is where, of a file that is still growing.

        Raises:
            SourceError: it is no MCAP file, or it cannot be read.
        """
        self.path = path
        try:
            self._survey = found or survey(path)
        except OSError as error:
            raise unreadable(path, error) from error
        self._cache = ChunkCache(path, self._survey.chunks)
        self._channels_of = _channels_by_topic(self._survey.book)
        self.topics = [
            topic
            for name in sorted(self._channels_of)
            if (topic := _topic(name, self._channels_of[name], self._survey.book)) is not None
        ]
        self.unread = _unread(self._survey.book, frozenset(self._channels_of))
        if found is None:
            warn_of_damage(path, self._survey)

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """The messages of some topics, in the order of the file."""
        book = self._survey.book if self._survey.is_listed else self._list(names)
        return {
            name: _merged([book.entries.get(number, []) for number in self._channels_of[name]])
            for name in names
        }

    def read(self, entry: Entry) -> bytes:
        """The bytes of a message.

        Raises:
            SourceError: they are damaged, or the file cannot be read.
        """
        place: Place = entry.place
        try:
            if place.chunk == IN_FILE:
                with self.path.open("rb") as stream:
                    stream.seek(place.start)
                    data = stream.read(place.length)
            else:
                whole = self._cache.get(place.chunk)
                data = whole[place.start : place.start + place.length]
        except OSError as error:
            raise unreadable(self.path, error) from error
        except Damaged as damage:
            raise SourceError(f"{self.path}: {damage} (at byte {damage.offset})") from damage
        if len(data) < place.length:
            raise SourceError(f"{self.path} ends inside a message")
        return data

    def _list(self, names: Collection[str]) -> Book:
        """Go through the chunks that hold messages of some topics."""
        wanted = frozenset(number for name in names for number in self._channels_of[name])
        known = self._survey.book
        book = Book(known.channels, known.schemas, codecs=known.codecs, wanted=wanted)
        try:
            with self.path.open("rb") as stream:
                for number, chunk in enumerate(self._survey.chunks):
                    if chunk.channels is None or chunk.channels & wanted:
                        self._list_chunk(book, stream, number, chunk)
        except OSError as error:
            raise unreadable(self.path, error) from error
        return book

    def _list_chunk(self, book: Book, stream: BinaryIO, number: int, chunk: Chunk) -> None:
        head = chunk.head
        try:
            # Its checksum is looked at when a message is read.
            if chunk.is_packed:
                book.go_through(UnpackedStream(stream, chunk), 0, head.unpacked_size, number)
            else:
                end = head.start + head.size
                book.go_through(stream, head.start, end, number, offset=head.start)
        except Damaged as damage:
            _log.warning(
                "%s: %s at byte %d: messages between %s and %s are left out",
                self.path,
                damage,
                head.start,
                _seconds(head.first_ns),
                _seconds(head.last_ns),
            )


def _channels_by_topic(book: Book) -> dict[str, list[int]]:
    channels: dict[str, list[int]] = {}
    for number, channel in sorted(book.channels.items()):
        is_there = number in book.tallies and book.tallies[number].count > 0
        if is_there and book.codec(number) is not None:
            channels.setdefault(channel.topic, []).append(number)
    return channels


def _unread(book: Book, known: frozenset[str]) -> list[UnreadTopic]:
    """The topics besides those that are known; the first channel says what kind they are."""
    found: dict[str, UnreadTopic] = {}
    for number, channel in sorted(book.channels.items()):
        if channel.topic not in known:
            schema = book.schemas.get(channel.schema_id)
            kind = channel.message_encoding if schema is None else schema.name
            topic = found.get(channel.topic, UnreadTopic(channel.topic, kind, 0))
            count = book.tallies[number].count if number in book.tallies else 0
            found[channel.topic] = topic._replace(messages=topic.messages + count)
    return [found[name] for name in sorted(found)]


def _topic(name: str, numbers: list[int], book: Book) -> Topic | None:
    """A topic of one or more channels; the first says what kind it is."""
    codec = book.codec(numbers[0])
    tallies = [book.tallies[number] for number in numbers]
    if codec is None:
        return None
    return Topic(
        name=name,
        schema=book.schemas[book.channels[numbers[0]].schema_id].name,
        codec=codec,
        count=sum(tally.count for tally in tallies),
        span_ns=max(t.last_ns for t in tallies) - min(t.first_ns for t in tallies),
    )


def _merged(lists: list[list[Entry]]) -> list[Entry]:
    if len(lists) == 1:
        return lists[0]
    return sorted((entry for entries in lists for entry in entries), key=lambda e: e.log_ns)


def warn_of_damage(path: Path, found: Survey) -> None:
    """Say how much of a file is used, if not all of it."""
    if found.damage is not None:
        size = path.stat().st_size
        tallies = found.book.tallies.values()
        count = sum(tally.count for tally in tallies)
        span_ns = max((t.last_ns for t in tallies), default=0) - min(
            (t.first_ns for t in tallies), default=0
        )
        _log.warning(
            "%s is cut off or damaged at byte %d of %d (%s); what can be read: %d "
            "messages in %.1f s, %.1f %% of the bytes",
            path,
            found.damage.offset,
            size,
            found.damage,
            count,
            span_ns / NS_PER_S if count else 0.0,
            100.0 * found.end / size,
        )
    if found.lost:
        _log.warning(
            "%s: %d of %d chunks are damaged and left out",
            path,
            found.lost,
            max(len(found.chunks), found.lost),
        )


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // NS_PER_S}.{stamp_ns % NS_PER_S:09d} s"


def unreadable(path: Path, error: OSError) -> SourceError:
    """What is said of a file that the system does not hand out."""
    return SourceError(f"{path} cannot be read: {error.strerror or error}")
