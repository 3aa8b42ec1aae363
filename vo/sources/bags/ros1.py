"""ROS 1 bags (version 2.0): chunks of records with an index, which a cut-off bag lacks.

Source: https://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from vo.errors import SourceError
from vo.formats.codecs import find_codec
from vo.formats.messages import HEAD_BYTES, Codec
from vo.sources.bags.ros1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MESSAGE,
    Chunk,
    ChunkCache,
    Connection,
    Cut,
    Record,
    connection_of,
    log_ns_of,
    records_of,
    top_level,
)
from vo.sources.logs.log import Entry, Topic, UnreadTopic
from vo.sources.logs.opening import open_log
from vo.sources.source import Recording
from vo.types import Mode

_log = logging.getLogger(__name__)


def open_rosbag1(
    path: Path, calibration: Path | None, mode: Mode, topics: Sequence[str] = ()
) -> Recording:
    """Open a bag; of one that was cut off, what is there.

    Raises:
        SourceError: it is no bag, holds no images, or it cannot be told which.
        CalibrationError: the calibration is missing or cannot be true.
    """
    return open_log(Bag(path), "rosbag1", calibration, mode, topics)


class _Place(NamedTuple):
    """Where the data of a message is in its unpacked chunk."""

    chunk: int
    start: int
    length: int


class _Tally(NamedTuple):
    messages: int
    first_ns: int
    last_ns: int


class Bag:
    """A `Log` in a ROS 1 bag; it is open only while something is read from it."""

    def __init__(self, path: Path) -> None:
        """Find out which topics there are.

        Raises:
            SourceError: it is no bag, or it cannot be read.
        """
        self.path = path
        self._chunks: list[Chunk] = []
        self._connections: dict[int, Connection] = {}
        self._tallies: dict[int, _Tally] = {}
        try:
            damage = self._survey()
        except OSError as error:
            raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
        self._cache = ChunkCache(path, self._chunks)
        if damage is not None:
            self._salvage(damage)
        self._codecs = {
            number: codec
            for number, known in self._connections.items()
            if number in self._tallies
            and (codec := find_codec("ros1", known.kind, "ros1msg", known.definition)) is not None
        }
        names = sorted({self._connections[number].topic for number in self._codecs})
        self.topics = [self._topic(name) for name in names]
        self.unread = self._others(frozenset(names))

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """The messages of some topics, in the order of the bag."""
        found: dict[str, list[Entry]] = {name: [] for name in names}
        wanted = {n for n in self._codecs if self._connections[n].topic in found}
        for number, chunk in enumerate(self._chunks):
            if chunk.connections and not chunk.connections & wanted:
                continue
            try:
                for record in self._messages(number):
                    if record.connection in wanted:
                        entry = _entry(record, number, self._codecs[record.connection])
                        found[self._connections[record.connection].topic].append(entry)
            except (SourceError, Cut) as error:
                _log.warning("%s; messages of that chunk are left out", error)
        return found

    def read(self, entry: Entry) -> bytes:
        """The bytes of a message.

        Raises:
            SourceError: they are damaged, or the file cannot be read.
        """
        place: _Place = entry.place
        data = self._cache.get(place.chunk)
        return data[place.start : place.start + place.length]

    def _survey(self) -> Cut | None:
        """List chunks and connections; what is wrong with the bag, if something is."""
        indexed: set[int] = set()
        try:
            for record in top_level(self.path):
                if record.op == CHUNK:
                    self._chunks.append(Chunk.of(record))
                elif record.op == INDEX and self._chunks:
                    self._chunks[-1].connections.add(record.connection)
                elif record.op == CONNECTION:
                    self._connections[record.connection] = connection_of(record)
                elif record.op == CHUNK_INFO:
                    indexed.add(record.number("chunk_pos", 8))
                    self._count(record)
        except Cut as cut:
            return cut
        if len(indexed) < len(self._chunks):
            return Cut(self.path.stat().st_size, "its index is missing")
        return None

    def _count(self, info: Record) -> None:
        first, last = info.time("start_time"), info.time("end_time")
        for at in range(0, len(info.data) - 7, 8):
            connection = int.from_bytes(info.data[at : at + 4], "little")
            count = int.from_bytes(info.data[at + 4 : at + 8], "little")
            self._note(connection, count, first, last)

    def _note(self, connection: int, count: int, first_ns: int, last_ns: int) -> None:
        before = self._tallies.get(connection, _Tally(0, first_ns, last_ns))
        self._tallies[connection] = _Tally(
            before.messages + count, min(before.first_ns, first_ns), max(before.last_ns, last_ns)
        )

    def _salvage(self, damage: Cut) -> None:
        """Without an index, all chunks are gone through once."""
        self._tallies.clear()
        for number, chunk in enumerate(self._chunks):
            chunk.connections.clear()
            try:
                for record in records_of(self._cache.get(number)):
                    if record.op == CONNECTION:
                        self._connections.setdefault(record.connection, connection_of(record))
                    elif record.op == MESSAGE:
                        time = log_ns_of(record)
                        self._note(record.connection, 1, time, time)
                        chunk.connections.add(record.connection)
            except (SourceError, Cut) as error:
                _log.warning("%s: a chunk at byte %d: %s", self.path, chunk.start, error)
        if not self._tallies:
            raise SourceError(f"{self.path} holds no message that can be read: {damage}")
        first = min(tally.first_ns for tally in self._tallies.values())
        last = max(tally.last_ns for tally in self._tallies.values())
        _log.warning(
            "%s: %s; %d messages in %.1f s can be read",
            self.path,
            damage,
            sum(tally.messages for tally in self._tallies.values()),
            (last - first) * 1e-9,
        )

    def _messages(self, number: int) -> list[Record]:
        """The messages of a chunk, as far as it is sound."""
        messages = []
        try:
            for record in records_of(self._cache.get(number)):
                if record.op == MESSAGE:
                    messages.append(record)
        except Cut:
            pass  # told of when the bag was opened
        return messages

    def _topic(self, name: str) -> Topic:
        """A topic, to which several nodes may have published."""
        numbers = [n for n in self._codecs if self._connections[n].topic == name]
        tallies = [self._tallies[number] for number in numbers]
        span_ns = max(t.last_ns for t in tallies) - min(t.first_ns for t in tallies)
        kind, codec = self._connections[numbers[0]].kind, self._codecs[numbers[0]]
        return Topic(name, kind, codec, sum(t.messages for t in tallies), span_ns)

    def _others(self, known: frozenset[str]) -> list[UnreadTopic]:
        found: dict[str, UnreadTopic] = {}
        for number, connection in sorted(self._connections.items()):
            if connection.topic not in known:
                topic = found.get(connection.topic)
                topic = topic or UnreadTopic(connection.topic, connection.kind, 0)
                tally = self._tallies.get(number)
                count = topic.messages + (0 if tally is None else tally.messages)
                found[connection.topic] = topic._replace(messages=count)
        return [found[name] for name in sorted(found)]


def _entry(record: Record, chunk: int, codec: Codec) -> Entry:
    try:
        stamp_ns = codec.peek_stamp_ns(bytes(record.data[:HEAD_BYTES]))
    except SourceError:
        stamp_ns = None
    return Entry(log_ns_of(record), stamp_ns, _Place(chunk, record.start, len(record.data)))
