"""ROS 1 bags (version 2.0): chunks of records and an index, which is missing in truncated bags.

Source: https://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import SourceError
from vo.base.types import Mode
from vo.recordings.formats.codecs import find_codec
from vo.recordings.formats.messages import HEAD_BYTES, Codec
from vo.recordings.sources.bags.ros1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MESSAGE,
    Chunk,
    ChunkCache,
    Connection,
    Damaged,
    Record,
    chunk_records,
    connection_of,
    file_records,
    log_ns_of,
)
from vo.recordings.sources.logs.log import Entry, Topic, UnreadTopic
from vo.recordings.sources.logs.opening import open_log
from vo.recordings.sources.source import Recording

_log = logging.getLogger(__name__)


def open_rosbag1(
    path: Path,
    calibration: Path | None,
    mode: Mode,
    topics: Sequence[str] = (),
    right_offset_ns: int | None = None,
) -> Recording:
    """Open a bag; of a truncated bag, the readable part."""
    return open_log(Bag(path), "rosbag1", calibration, mode, topics, right_offset_ns)


class _Address(NamedTuple):
    """Address of the data of a message in its decompressed chunk."""

    chunk: int
    start: int
    length: int


class _Statistics(NamedTuple):
    messages: int
    first_ns: int
    last_ns: int


class Bag:
    """A `Log` in a ROS 1 bag; the file is open only during reads."""

    def __init__(self, path: Path) -> None:
        """Read the index of the bag; a bag without an index is scanned."""
        self.path = path
        self._chunks: list[Chunk] = []
        self._connections: dict[int, Connection] = {}
        self._statistics: dict[int, _Statistics] = {}
        try:
            damage = self._read_index()
        except OSError as error:
            raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
        self._cache = ChunkCache(path, self._chunks)
        if damage is not None:
            self._scan_chunks(damage)
        self._codecs = {
            number: codec
            for number, connection in self._connections.items()
            if number in self._statistics
            and (codec := find_codec("ros1", connection.kind, "ros1msg", connection.definition))
            is not None
        }
        names = sorted({self._connections[number].topic for number in self._codecs})
        self.topics = [self._topic(name) for name in names]
        self.unread = self._others(frozenset(names))

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """See `Log.entries`."""
        found: dict[str, list[Entry]] = {name: [] for name in names}
        selected = {n for n in self._codecs if self._connections[n].topic in found}
        for number, chunk in enumerate(self._chunks):
            if chunk.connections and not chunk.connections & selected:
                continue
            try:
                for record in self._messages(number):
                    if record.connection in selected:
                        entry = _entry(record, number, self._codecs[record.connection])
                        found[self._connections[record.connection].topic].append(entry)
            except (SourceError, Damaged) as error:
                _log.warning("%s; messages of that chunk are skipped", error)
        return found

    def read(self, entry: Entry) -> bytes:
        """Read the bytes of a message."""
        address: _Address = entry.address
        data = self._cache.get(address.chunk)
        return data[address.start : address.start + address.length]

    def _read_index(self) -> Damaged | None:
        """List chunks and connections; return the damage of the bag, or None."""
        indexed: set[int] = set()
        try:
            for record in file_records(self.path):
                if record.op == CHUNK:
                    self._chunks.append(Chunk.of(record))
                elif record.op == INDEX and self._chunks:
                    self._chunks[-1].connections.add(record.connection)
                elif record.op == CONNECTION:
                    self._connections[record.connection] = connection_of(record)
                elif record.op == CHUNK_INFO:
                    indexed.add(record.number("chunk_pos", 8))
                    self._count(record)
        except Damaged as damage:
            return damage
        if len(indexed) < len(self._chunks):
            return Damaged(self.path.stat().st_size, "its index is missing")
        return None

    def _count(self, info: Record) -> None:
        first, last = info.time("start_time"), info.time("end_time")
        for at in range(0, len(info.data) - 7, 8):
            connection = int.from_bytes(info.data[at : at + 4], "little")
            count = int.from_bytes(info.data[at + 4 : at + 8], "little")
            self._add_count(connection, count, first, last)

    def _add_count(self, connection: int, count: int, first_ns: int, last_ns: int) -> None:
        before = self._statistics.get(connection, _Statistics(0, first_ns, last_ns))
        self._statistics[connection] = _Statistics(
            before.messages + count, min(before.first_ns, first_ns), max(before.last_ns, last_ns)
        )

    def _scan_chunks(self, damage: Damaged) -> None:
        """Scan all chunks of a bag without an index."""
        self._statistics.clear()
        reasons = []
        for number, chunk in enumerate(self._chunks):
            chunk.connections.clear()
            try:
                for record in chunk_records(self._cache.get(number)):
                    if record.op == CONNECTION:
                        self._connections.setdefault(record.connection, connection_of(record))
                    elif record.op == MESSAGE:
                        time = log_ns_of(record)
                        self._add_count(record.connection, 1, time, time)
                        chunk.connections.add(record.connection)
            except SourceError as error:
                reasons.append(str(error))
            except Damaged as error:
                reasons.append(f"{self.path}: a chunk at byte {chunk.start}: {error}")
        if not self._statistics:
            reason = reasons[0] if reasons else f"{self.path}: {damage}"
            raise SourceError(f"{reason}; no message can be read")
        for reason in reasons:
            _log.warning("%s", reason)
        first = min(each.first_ns for each in self._statistics.values())
        last = max(each.last_ns for each in self._statistics.values())
        _log.warning(
            "%s: %s; readable: %d messages in %.1f s",
            self.path,
            damage,
            sum(each.messages for each in self._statistics.values()),
            (last - first) * 1e-9,
        )

    def _messages(self, number: int) -> list[Record]:
        """The messages of a chunk, up to the first damage."""
        messages = []
        try:
            for record in chunk_records(self._cache.get(number)):
                if record.op == MESSAGE:
                    messages.append(record)
        except Damaged:
            pass  # reported when the bag was opened
        return messages

    def _topic(self, name: str) -> Topic:
        """A topic, possibly with several publishers."""
        numbers = [n for n in self._codecs if self._connections[n].topic == name]
        statistics = [self._statistics[number] for number in numbers]
        span_ns = max(t.last_ns for t in statistics) - min(t.first_ns for t in statistics)
        kind, codec = self._connections[numbers[0]].kind, self._codecs[numbers[0]]
        return Topic(name, kind, codec, sum(t.messages for t in statistics), span_ns)

    def _others(self, readable: frozenset[str]) -> list[UnreadTopic]:
        found: dict[str, UnreadTopic] = {}
        for number, connection in sorted(self._connections.items()):
            if connection.topic not in readable:
                topic = found.get(connection.topic)
                topic = topic or UnreadTopic(connection.topic, connection.kind, 0)
                statistics = self._statistics.get(number)
                count = topic.messages + (0 if statistics is None else statistics.messages)
                found[connection.topic] = topic._replace(messages=count)
        return [found[name] for name in sorted(found)]


def _entry(record: Record, chunk: int, codec: Codec) -> Entry:
    try:
        stamp_ns = codec.peek_stamp_ns(bytes(record.data[:HEAD_BYTES]))
    except SourceError:
        stamp_ns = None
    return Entry(log_ns_of(record), stamp_ns, _Address(chunk, record.start, len(record.data)))
