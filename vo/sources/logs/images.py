"""Images in the messages of a log, listed with their stamps."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vo.errors import SourceError, VoError
from vo.formats.messages import CompressedImageMessage, CompressedVideoMessage, ImageMessage
from vo.formats.pixels import colour_pixels, grey_pixels
from vo.sources.images import Pixels, StoredImage, decode_image
from vo.sources.listing import LARGEST_NS, Shot
from vo.sources.logs.log import Entry, Log, Topic

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class MessageImage:
    """A `StoredImage` in a message."""

    log: Log
    topic: Topic
    entry: Entry

    @property
    def name(self) -> str:
        """Topic and time of logging, as other tools show it."""
        return f"{self.log.path}: {self.topic.name} logged at {self.entry.log_ns} ns"

    def read(self, colour: bool = False) -> Pixels:
        """The image as `StoredImage.read` has it; also raises as that does."""
        try:
            message = self.topic.codec.decode(self.log.read(self.entry))
            if isinstance(message, ImageMessage):
                return colour_pixels(message) if colour else grey_pixels(message)
        except SourceError as error:
            raise SourceError(f"image {self.name}: {error}") from error
        assert isinstance(message, CompressedImageMessage)
        return decode_image(message.data, self.name, colour)


def list_images(log: Log, topic: Topic, entries: Sequence[Entry]) -> list[Shot]:
    """The images of a topic in the order of their stamps.

    Stamps are those of the messages' headers; of messages without one the time of logging, with a
    warning. Of several messages with one stamp the first is taken.

    Raises:
        SourceError: there is no image.
    """
    return list_shots(log, topic, entries, image_maker(log, topic, entries))


def list_shots(
    log: Log, topic: Topic, entries: Sequence[Entry], image: Callable[[int], StoredImage]
) -> list[Shot]:
    """As `list_images`, of images that `image` makes of the number of a message."""
    ordered = in_order(log, topic, entries)
    shots: list[Shot] = []
    for stamp_ns, number in ordered:
        if stamp_ns <= LARGEST_NS and (not shots or stamp_ns > shots[-1].stamp_ns):
            shots.append(Shot(stamp_ns, image(number), f"{log.path}: {topic.name}"))
    if not shots:
        raise SourceError(f"{log.path}: no message of {topic.name} can be read")
    if len(shots) < len(ordered):
        repeated = len(ordered) - len(shots)
        _log.warning("%s: %d images repeat a stamp and are not used", topic.name, repeated)
    return shots


def in_order(log: Log, topic: Topic, entries: Sequence[Entry]) -> list[tuple[int, int]]:
    """Stamps and numbers of messages, by stamp; that of logging where a message has none."""
    stamped = [(stamp_of(log, topic, entry), entry) for entry in entries]
    unstamped = sum(not stamp_ns for stamp_ns, _ in stamped)
    if unstamped:
        _log.warning(
            "%s: %d of %d messages have no stamp; the time when they were logged is taken",
            topic.name,
            unstamped,
            len(entries),
        )
    return sorted(
        (stamp_ns or entry.log_ns, number) for number, (stamp_ns, entry) in enumerate(stamped)
    )


def image_maker(log: Log, topic: Topic, entries: Sequence[Entry]) -> Callable[[int], StoredImage]:
    """Makes the image of a message by its number; frames of a video hang on those before them.

    Args:
        log: where the messages are.
        topic: theirs.
        entries: all of them, in the order of the log; may grow.
    """
    if not issubclass(topic.codec.kind, CompressedVideoMessage):
        return lambda number: MessageImage(log, topic, entries[number])
    from vo.sources.logs.video import LogVideo, VideoImage  # av takes a while to import

    video = LogVideo(log, topic, entries)
    return lambda number: VideoImage(video, number, entries[number])


def stamp_of(log: Log, topic: Topic, entry: Entry) -> int:
    """The stamp in a message's header; 0 where there is none."""
    stamp_ns = entry.stamp_ns
    if stamp_ns is None:
        try:
            stamp_ns = topic.codec.decode(log.read(entry)).stamp_ns
        except VoError:
            return 0
    return stamp_ns if 0 < stamp_ns <= LARGEST_NS else 0
