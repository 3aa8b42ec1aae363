"""ROS 1 bags (version 2.0): chunks of records and an index, which is missing in truncated bags.

Source: https://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import SourceError
from vo.recordings.formats.codecs import find_codec
from vo.recordings.formats.messages import HEAD_BYTES, Codec
from vo.recordings.sources.bags.ros1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MESSAGE,
    Chunk,
    Connection,
    Damaged,
    Record,
    chunk_records,
    connection_of,
    file_records,
    load_chunk,
    log_ns_of,
)
from vo.recordings.sources.logs.log import (
    ChunkCache,
    Entry,
    MessageSpan,
    Topic,
    UnreadTopic,
    topic_of,
    unread_topics,
)

_log = logging.getLogger(__name__)


class _Address(NamedTuple):
    """Address of the data of a message in its decompressed chunk."""

    chunk: int
    start: int
    length: int


class Bag:
    """A `Log` in a ROS 1 bag; the file is open only during reads."""

    def __init__(self, path: Path) -> None:
        """Read the index of the bag; a bag without an index is scanned."""
        self.path = path
        self._chunks: list[Chunk] = []
        self._connections: dict[int, Connection] = {}
        self._statistics: dict[int, MessageSpan] = {}
        try:
            damage = self._read_index()
        except OSError as error:
            raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
        self._cache = ChunkCache(lambda number: load_chunk(path, self._chunks[number]))
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
        self.unread = unread_topics(self._all_topics(), names)

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

    def metadata(self, name: str) -> Mapping[str, str]:
        """See `Log.metadata`: the format has none."""
        return {}

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
        self._statistics.setdefault(connection, MessageSpan()).add_all(count, first_ns, last_ns)

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
            sum(each.count for each in self._statistics.values()),
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
        numbers = [n for n in self._codecs if self._connections[n].topic == name]
        kind, codec = self._connections[numbers[0]].kind, self._codecs[numbers[0]]
        return topic_of(name, kind, codec, [self._statistics[number] for number in numbers])

    def _all_topics(self) -> Iterator[UnreadTopic]:
        for number, each in sorted(self._connections.items()):
            statistics = self._statistics.get(number, MessageSpan())
            yield UnreadTopic(each.topic, each.kind, statistics.count)


def _entry(record: Record, chunk: int, codec: Codec) -> Entry:
    try:
        stamp_ns = codec.peek_stamp_ns(bytes(record.data[:HEAD_BYTES]))
    except SourceError:
        stamp_ns = None
    return Entry(log_ns_of(record), stamp_ns, _Address(chunk, record.start, len(record.data)))
