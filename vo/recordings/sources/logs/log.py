"""Contract of log containers: topics, lists of messages, and reading of single messages."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from vo.recordings.formats.messages import Codec

NS_PER_S = 1_000_000_000
_MAX_CACHED_BYTES = 64 * 2**20
_MIN_CACHED = 2  # left and right images may be in different chunks


class Entry(NamedTuple):
    """Location of a message; small, as hours of recording have several 100,000 messages.

    Attributes:
        stamp_ns: stamp in the header of the message; None if reading it requires decoding.
        address: address of the message, in a form specific to the container.
    """

    log_ns: int
    stamp_ns: int | None
    address: Any


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic whose messages can be decoded.

    Attributes:
        span_ns: time between the first and the last message, 0 if unknown.
    """

    name: str
    schema: str
    codec: Codec
    count: int
    span_ns: int

    @property
    def rate_hz(self) -> float:
        """Messages per second; 0 if unknown."""
        return (self.count - 1) * NS_PER_S / self.span_ns if self.span_ns > 0 else 0.0


@dataclass
class MessageSpan:
    """Number of messages, and range of their log times."""

    count: int = 0
    first_ns: int = 2**63
    last_ns: int = 0

    def add(self, log_ns: int) -> None:
        """Add a message."""
        self.add_all(1, log_ns, log_ns)

    def add_all(self, count: int, first_ns: int, last_ns: int) -> None:
        """Add several messages."""
        self.count += count
        self.first_ns = min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)


def topic_of(name: str, schema: str, codec: Codec, spans: Sequence[MessageSpan]) -> Topic:
    """A topic, possibly with several publishers."""
    span_ns = max(each.last_ns for each in spans) - min(each.first_ns for each in spans)
    return Topic(name, schema, codec, sum(each.count for each in spans), span_ns)


class UnreadTopic(NamedTuple):
    """A topic of an unsupported message type, or without messages."""

    name: str
    schema: str
    messages: int


def unread_topics(found: Iterable[UnreadTopic], readable: Collection[str]) -> list[UnreadTopic]:
    """The topics that are not readable, sorted; parts of one are added, the first has the type."""
    joined: dict[str, UnreadTopic] = {}
    for topic in found:
        if topic.name not in readable:
            before = joined.get(topic.name, topic._replace(messages=0))
            joined[topic.name] = before._replace(messages=before.messages + topic.messages)
    return [joined[name] for name in sorted(joined)]


class ChunkCache:
    """Thread-safe cache of the most recently used chunks of a log, decompressed."""

    def __init__(self, load: Callable[[int], bytes]) -> None:
        self._load = load
        self._lock = threading.Lock()
        self._cached: OrderedDict[int, Future[bytes]] = OrderedDict()

    def get(self, number: int) -> bytes:
        """The records of a chunk; waits for one that another thread is decompressing."""
        with self._lock:
            waiting = self._cached.get(number)
            future: Future[bytes] = waiting or Future()
            self._cached[number] = future
            self._cached.move_to_end(number)
        if waiting is None:
            try:
                future.set_result(self._load(number))
            except BaseException as error:
                future.set_exception(error)
            with self._lock:
                self._drop_oldest()
        return future.result()

    def _drop_oldest(self) -> None:
        size = sum(map(_size, self._cached.values()))
        while size > _MAX_CACHED_BYTES and len(self._cached) > _MIN_CACHED:
            size -= _size(self._cached.popitem(last=False)[1])


def _size(chunk: Future[bytes]) -> int:
    return len(chunk.result()) if chunk.done() and chunk.exception() is None else 0


class Log(Protocol):
    """A container of messages."""

    @property
    def path(self) -> Path:
        """File or folder of the log."""
        ...

    @property
    def topics(self) -> Sequence[Topic]:
        """Topics with messages of a supported type, sorted by name."""
        ...

    @property
    def unread(self) -> Sequence[UnreadTopic]:
        """All other topics, sorted by name."""
        ...

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """List the messages of some topics, in the order of the log.

        All topics are listed in one pass, because it may read the whole container. Damaged messages
        are skipped with a warning.
        """
        ...

    def metadata(self, name: str) -> Mapping[str, str]:
        """Facts that the recorder stored under a name; empty without any."""
        ...

    def read(self, entry: Entry) -> bytes:
        """Read the bytes of a message; thread-safe.

        Raises:
            SourceError: the message is damaged.
        """
        ...
