"""Images in the messages of a log, with their stamps."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from vo.base.errors import SourceError
from vo.base.extras import require
from vo.base.faults import Fault
from vo.recordings.formats.messages import (
    CompressedImageMessage,
    CompressedVideoMessage,
    ImageMessage,
)
from vo.recordings.formats.pixels import (
    as_other_yuv,
    colour_pixels,
    depth_pixels,
    grey_pixels,
    has_wrong_step,
    other_pixel_bytes,
)
from vo.recordings.formats.stamp_units import MAX_STAMP_NS
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.grey_levels import difference
from vo.recordings.sources.images import Pixels, StoredImage, decode_image
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.stamps import message_stamps

_log = logging.getLogger(__name__)

_CHECKED_IMAGES = 3
_MAX_COLOUR_DIFFERENCE = 0.4  # of that of the brightness
_IMAGE_FORMAT = re.compile(r"jpe?g|jp2|j2k|png|tiff?|bmp|webp|avif|exr|p[bgnp]m", re.IGNORECASE)
_MAX_SHOWN = 40  # characters
_PNG = b"\x89PNG"
_DEPTH_HEADER = 12
"""Bytes of the header of `compressed_depth_image_transport`, in front of the PNG."""


@dataclass(frozen=True, eq=False)
class MessageImage:
    """A `StoredImage` in a message, or with `is_depth` depth in millimetres, 0 where unknown.

    `pixel_format`: replaces that of the message; empty if that is right.
    """

    log: Log
    topic: Topic
    entry: Entry
    is_depth: bool = False
    pixel_format: str = ""

    @property
    def name(self) -> str:
        """Topic and log time, as shown by other tools."""
        return f"{self.log.path}: {self.topic.name} logged at {self.entry.log_ns} ns"

    def read(self, colour: bool = False) -> Pixels:
        """See `StoredImage.read`; depth is uint16 or float32, whatever `colour` is."""
        try:
            message = self.topic.codec.decode(self.log.read(self.entry))
            if isinstance(message, ImageMessage):
                if self.pixel_format:
                    message = replace(message, pixel_format=self.pixel_format)
                if self.is_depth:
                    return depth_pixels(message)
                return colour_pixels(message) if colour else grey_pixels(message)
        except SourceError as error:
            what = "depth image" if self.is_depth else "image"
            raise SourceError(f"{what} {self.name}: {error}") from error
        if not isinstance(message, CompressedImageMessage):
            raise SourceError(f"image {self.name} is a frame of a video, not an image")
        data = message.data
        if self.is_depth and not data.startswith(_PNG) and data[_DEPTH_HEADER:].startswith(_PNG):
            data = data[_DEPTH_HEADER:]
        try:
            return decode_image(data, self.name, colour and not self.is_depth)
        except SourceError as error:
            stated = message.image_format[:_MAX_SHOWN]
            if not stated.strip() or _IMAGE_FORMAT.search(stated):
                raise
            raise SourceError(f"{error} (its message gives the format {stated!r})") from error


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
    if not _has_video(log, topic, entries):
        _check_pixel_bytes(log, topic, entries)
        order = _order_of_yuv(log, topic, entries)
        return lambda number: MessageImage(log, topic, entries[number], pixel_format=order)
    require("av", extra="video", what="video messages")
    from vo.recordings.sources.logs.video import LogVideo, VideoImage  # av is slow to import

    video = LogVideo(log, topic, entries)
    return lambda number: VideoImage(video, number, entries[number])


def _has_video(log: Log, topic: Topic, entries: Sequence[Entry]) -> bool:
    """Whether the type of the messages or, of compressed images, the first message says so."""
    if topic.codec.kind is not CompressedImageMessage:
        return issubclass(topic.codec.kind, CompressedVideoMessage)
    for entry in entries[:_CHECKED_IMAGES]:
        try:
            message = topic.codec.decode(log.read(entry))
        except SourceError:
            continue
        return isinstance(message, CompressedVideoMessage)
    return False


def _order_of_yuv(log: Log, topic: Topic, entries: Sequence[Entry]) -> str:
    """The encoding that the pixels have instead of the stated one, with a warning; or nothing.

    The colour of an image is much smoother than its brightness.
    """
    found, votes = None, []
    for entry in entries[:: max(1, len(entries) // _CHECKED_IMAGES)]:
        try:
            message = topic.codec.decode(log.read(entry))
            if not isinstance(message, ImageMessage):
                return ""
            if found is None:
                _warn_of_wrong_step(topic, message)
            found = as_other_yuv(message)
            if found is None:
                return ""
            # Two values alternate in the colour, so that pixels two columns apart are compared.
            stated, other = (difference(grey_pixels(each), 2) for each in (message, found))
        except SourceError:
            continue
        votes.append(stated < _MAX_COLOUR_DIFFERENCE * other)
    if found is None or not votes or not all(votes):
        return ""
    _log.warning("%s: pixels are not as stated, and read as %s", topic.name, found.pixel_format)
    return found.pixel_format


def _check_pixel_bytes(log: Log, topic: Topic, entries: Sequence[Entry]) -> None:
    for entry in entries[:1]:
        try:
            message = topic.codec.decode(log.read(entry))
            if not isinstance(message, ImageMessage):
                return
            count = other_pixel_bytes(message)
        except SourceError:
            return
        if count:
            raise SourceError(
                f"{topic.name}: rows have {count} bytes for each pixel, which "
                f"{message.pixel_format} has not: the encoding is another; write the images again "
                "with theirs"
            )


def _warn_of_wrong_step(topic: Topic, message: ImageMessage) -> None:
    if has_wrong_step(message):
        _log.warning(
            "%s: rows of %dx%d %s are said to have %d bytes, but the data are those of whole rows "
            "without padding, and read so",
            topic.name,
            message.width,
            message.height,
            message.pixel_format,
            message.step,
        )
