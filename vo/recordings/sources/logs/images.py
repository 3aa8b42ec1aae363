"""Images in the messages of a log, with their stamps."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vo.base.errors import SourceError
from vo.base.extras import require
from vo.base.faults import Fault
from vo.recordings.formats.messages import (
    CompressedImageMessage,
    CompressedVideoMessage,
    ImageMessage,
)
from vo.recordings.formats.pixels import colour_pixels, depth_pixels, grey_pixels
from vo.recordings.formats.stamp_units import MAX_STAMP_NS
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.images import Pixels, StoredImage, decode_image
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.stamps import message_stamps

_log = logging.getLogger(__name__)

_PNG = b"\x89PNG"
_DEPTH_HEADER = 12
"""Bytes of the header of `compressed_depth_image_transport`, in front of the PNG."""


@dataclass(frozen=True, eq=False)
class MessageImage:
    """A `StoredImage` in a message, or with `is_depth` depth in millimetres, 0 where unknown."""

    log: Log
    topic: Topic
    entry: Entry
    is_depth: bool = False

    @property
    def name(self) -> str:
        """Topic and log time, as shown by other tools."""
        return f"{self.log.path}: {self.topic.name} logged at {self.entry.log_ns} ns"

    def read(self, colour: bool = False) -> Pixels:
        """See `StoredImage.read`; depth is uint16 or float32, whatever `colour` is."""
        try:
            message = self.topic.codec.decode(self.log.read(self.entry))
            if isinstance(message, ImageMessage):
                if self.is_depth:
                    return depth_pixels(message)
                return colour_pixels(message) if colour else grey_pixels(message)
        except SourceError as error:
            what = "depth image" if self.is_depth else "image"
            raise SourceError(f"{what} {self.name}: {error}") from error
        assert isinstance(message, CompressedImageMessage)
        data = message.data
        if self.is_depth and not data.startswith(_PNG) and data[_DEPTH_HEADER:].startswith(_PNG):
            data = data[_DEPTH_HEADER:]
        return decode_image(data, self.name, colour and not self.is_depth)


def list_images(
    log: Log, topic: Topic, entries: Sequence[Entry], faults: list[Fault] | None = None
) -> list[Shot]:
    """The images of a topic, sorted by stamp (see `message_stamps`).

    Of messages with the same stamp, the first is used, with a warning.
    """
    return list_shots(log, topic, entries, image_factory(log, topic, entries), faults)


def list_shots(
    log: Log,
    topic: Topic,
    entries: Sequence[Entry],
    image: Callable[[int], StoredImage],
    faults: list[Fault] | None = None,
) -> list[Shot]:
    """Like `list_images`, for images created by `image(number of the message)`."""
    ordered = sorted_by_stamp(log, topic, entries, faults)
    shots: list[Shot] = []
    for stamp_ns, number in ordered:
        if stamp_ns <= MAX_STAMP_NS and (not shots or stamp_ns > shots[-1].stamp_ns):
            shots.append(Shot(stamp_ns, image(number), f"{log.path}: {topic.name}"))
    if not shots:
        raise SourceError(f"{log.path}: no message of {topic.name} can be read")
    if len(shots) < len(ordered):
        repeated = len(ordered) - len(shots)
        _log.warning(
            "%s: %d images repeat a stamp and are not used",
            topic.name,
            repeated,
            extra=warning_kind("repeated_stamps"),
        )
    return shots


def sorted_by_stamp(
    log: Log, topic: Topic, entries: Sequence[Entry], faults: list[Fault] | None = None
) -> list[tuple[int, int]]:
    """Pairs of stamp and message number, sorted; arguments as of `message_stamps`."""
    stamps = message_stamps(log, topic, entries, faults)
    return sorted((stamp_ns, number) for number, stamp_ns in enumerate(stamps))


def image_factory(log: Log, topic: Topic, entries: Sequence[Entry]) -> Callable[[int], StoredImage]:
    """A function that creates the image of a message, given its number.

    `entries`: all messages of the topic in the order of the log, as video frames depend on earlier
    ones; may grow.
    """
    if not issubclass(topic.codec.kind, CompressedVideoMessage):
        return lambda number: MessageImage(log, topic, entries[number])
    require("av", extra="video", what="video messages")
    from vo.recordings.sources.logs.video import LogVideo, VideoImage  # av is slow to import

    video = LogVideo(log, topic, entries)
    return lambda number: VideoImage(video, number, entries[number])
