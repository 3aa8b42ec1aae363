"""Messages in an SQLite file, the default storage of rosbag2."""

from __future__ import annotations

import logging
import re
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path

from vo.base.errors import SourceError
from vo.recordings.formats.codecs import find_codec
from vo.recordings.formats.decompression import decompress, size_limit
from vo.recordings.formats.messages import HEAD_BYTES
from vo.recordings.sources.logs.log import (
    Entry,
    MessageSpan,
    Topic,
    UnreadTopic,
    topic_of,
)

_log = logging.getLogger(__name__)
_TABLES = ("topics", "messages", "message_definitions")
_CREATED_TABLE = re.compile(r"\s*CREATE\s+TABLE\b", re.IGNORECASE)
_COMPUTED = re.compile(r"\bGENERATED\b|\bAS\s*\(", re.IGNORECASE)
# Instructions of SQLite's virtual machine; a message of a bag takes about 30 bytes and 15 of them.
_MIN_STEPS, _STEPS_PER_BYTE, _STEPS_PER_CALL = 1_000_000, 20, 100_000


class SqliteFile:
    """A `Log` in an SQLite file; the file is open only during reads."""

    def __init__(self, path: Path, *, compressed: bool = False) -> None:
        """List the topics.

        `compressed`: whether each message is compressed (zstd).
        """
        self.path = path
        self._compressed = compressed
        self._number: dict[str, int] = {}
        self.topics: list[Topic] = []
        self.unread: list[UnreadTopic] = []
        with self._opened() as database:
            _check_tables(path, database)
            definitions = _definitions(database)
            spans = _spans(path, database)
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
            for number, name, kind, encoding in sorted(rows, key=lambda row: str(row[1])):
                if not isinstance(name, str) or not isinstance(kind, str):  # NULL, or a number
                    _log.warning("%s: a topic without name or type is left out", path)
                    continue
                language, text = definitions.get(kind, ("ros2msg", ""))
                codec = find_codec(str(encoding), kind, language, text.encode())
                span = spans.get(number, MessageSpan())
                if codec is None or not span.count:
                    self.unread.append(UnreadTopic(name, kind, span.count))
                else:
                    self._number[name] = number
                    self.topics.append(topic_of(name, kind, codec, [span]))

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """See `Log.entries`."""
        with self._opened() as database:
            return {name: self._entries(database, name) for name in names if name in self._number}

    def metadata(self, name: str) -> Mapping[str, str]:
        """See `Log.metadata`: the format has none."""
        return {}

    def read(self, entry: Entry) -> bytes:
        """Read the bytes of a message."""
        with self._opened() as database:
            row = database.execute("SELECT data FROM messages WHERE id = ?", (entry.address,))
            found = row.fetchone()
        if found is None or not isinstance(found[0], bytes):
            raise SourceError(f"{self.path} has no readable message {entry.address}")
        return self._decompress(found[0])

    def _entries(self, database: sqlite3.Connection, name: str) -> list[Entry]:
        codec = next(topic.codec for topic in self.topics if topic.name == name)
        head = "data" if self._compressed else f"substr(data, 1, {HEAD_BYTES})"
        rows = database.execute(
            f"SELECT id, timestamp, {head} FROM messages WHERE topic_id = ? ORDER BY id",
            (self._number[name],),
        )
        entries = []
        try:
            for address, log_ns, data in rows:
                if not isinstance(log_ns, int) or not isinstance(data, bytes):
                    continue
                try:
                    stamp_ns = codec.peek_stamp_ns(self._decompress(data))
                except SourceError:
                    stamp_ns = None
                entries.append(Entry(log_ns, stamp_ns, address))
        except sqlite3.DatabaseError as error:
            _log.warning(
                "%s is damaged (%s): %s ends after %d messages",
                self.path,
                error,
                name,
                len(entries),
            )
        return entries

    def _decompress(self, data: bytes) -> bytes:
        if not self._compressed:
            return data
        try:
            return decompress(data, "zstd", size_limit(len(data)))
        except SourceError as error:
            raise SourceError(f"{self.path}: a message: {error}") from error

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        try:
            where = f"{self.path.resolve().as_uri()}?mode=ro"
            with closing(sqlite3.connect(where, uri=True)) as database:
                database.text_factory = lambda text: text.decode(errors="replace")
                _limit(database, self.path.stat().st_size)
                yield database
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter in names of columns
            raise SourceError(
                f"{self.path} cannot be read as a ROS 2 bag: {error}; try to recover a damaged "
                "one with `sqlite3 FILE .recover`"
            ) from error


def _limit(database: sqlite3.Connection, file_bytes: int) -> None:
    """Allow no more work and no larger values than an intact file of that size needs.

    Damaged or malicious files have pages that refer to each other, and columns that are computed.
    """
    database.execute("PRAGMA trusted_schema = OFF")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(max(file_bytes, 2**20), 2**30))
    left = 1 + (_MIN_STEPS + _STEPS_PER_BYTE * file_bytes) // _STEPS_PER_CALL

    def is_too_much() -> bool:
        nonlocal left
        left -= 1
        return left < 0

    database.set_progress_handler(is_too_much, _STEPS_PER_CALL)


def _check_tables(path: Path, database: sqlite3.Connection) -> None:
    """Refuse views, virtual tables and computed columns, which can be endless."""
    rows = database.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    for kind, name, text in rows:
        if str(name).lower() not in _TABLES:
            continue
        is_stored = kind == "table" and _CREATED_TABLE.match(str(text))
        if not is_stored or _COMPUTED.search(str(text)):
            raise SourceError(f"{path} is no ROS 2 bag: {str(name).lower()} is not a plain table")


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Language and text of the definition of each message type; only newer bags contain them."""
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    try:
        rows = database.execute(query).fetchall()
    except sqlite3.OperationalError:
        return {}
    return {row[0]: (row[1], row[2]) for row in rows if all(isinstance(x, str) for x in row)}


def _spans(path: Path, database: sqlite3.Connection) -> dict[int, MessageSpan]:
    spans: dict[int, MessageSpan] = {}
    try:
        for number, log_ns in database.execute("SELECT topic_id, timestamp FROM messages"):
            if not isinstance(log_ns, int):  # numbers in damaged pages are read as NULL
                continue
            spans.setdefault(number, MessageSpan(0, log_ns, log_ns)).add(log_ns)
    except sqlite3.DatabaseError as error:
        if not spans:
            raise
        total = sum(each.count for each in spans.values())
        _log.warning("%s is damaged (%s) after %d messages", path, error, total)
    return spans
