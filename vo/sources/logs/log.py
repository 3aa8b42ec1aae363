"""What a log is: topics, messages that are listed but not held, and a way to read each."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from vo.formats.messages import Codec

NS_PER_S = 1_000_000_000


class Entry(NamedTuple):
    """Where a message is; a recording of hours has some hundred thousand of them.

    Attributes:
        log_ns: when it was written down.
        stamp_ns: when it was measured, as the message itself says; None where that cannot be told
            without decoding it.
        place: where the container finds it again.
    """

    log_ns: int
    stamp_ns: int | None
    place: Any


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic whose messages can be read.

    Attributes:
        name: such as `/cam0/image_raw`.
        schema: name of its kind of message, as stored.
        codec: who reads the messages.
        count: of its messages.
        span_ns: between the first and the last, as far as the container says.
    """

    name: str
    schema: str
    codec: Codec
    count: int
    span_ns: int

    @property
    def rate_hz(self) -> float:
        """Messages in a second; 0 where that cannot be told."""
        return (self.count - 1) * NS_PER_S / self.span_ns if self.span_ns > 0 else 0.0


class UnreadTopic(NamedTuple):
    """A topic that nobody here reads, or that has no message."""

    name: str
    schema: str
    messages: int


class Log(Protocol):
    """A container of messages."""

    @property
    def path(self) -> Path:
        """Its file or folder."""
        ...

    @property
    def topics(self) -> Sequence[Topic]:
        """Those of which it knows who reads them and that hold a message, by name."""
        ...

    @property
    def unread(self) -> Sequence[UnreadTopic]:
        """All other topics, by name."""
        ...

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """The messages of some topics, in the order of the log.

        One pass for all of them, as that may mean reading the container from end to end. What is
        damaged is warned of and left out.
        """
        ...

    def read(self, entry: Entry) -> bytes:
        """The bytes of a message; called from several threads at a time.

        Raises:
            SourceError: they are damaged.
        """
        ...
