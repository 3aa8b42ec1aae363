"""Contract of log containers: topics, lists of messages, and reading of single messages."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from vo.recordings.formats.messages import Codec

NS_PER_S = 1_000_000_000


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


class UnreadTopic(NamedTuple):
    """A topic of an unsupported message type, or without messages."""

    name: str
    schema: str
    messages: int


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

    def read(self, entry: Entry) -> bytes:
        """Read the bytes of a message; thread-safe.

        Raises:
            SourceError: the message is damaged.
        """
        ...
