"""Depth images in a log, registered to the left camera."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from vo.base.errors import SourceError, VoError
from vo.recordings.formats.messages import CompressedImageMessage, ImageMessage
from vo.recordings.formats.pixels import grey_pixels
from vo.recordings.sources.images import Pixels, decode_image
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.images import list_shots
from vo.recordings.sources.logs.log import Entry, Log, Topic

_log = logging.getLogger(__name__)

UNITS_PER_METRE = 1000.0
"""Depth is in millimetres, as in 16-bit images of ROS (REP 118); floats in metres are converted."""

_PNG = b"\x89PNG"
_HEADER_BYTES = 12
"""Size of the header of `compressed_depth_image_transport`, in front of the PNG."""

_NAMED_DEPTH = re.compile(r"depth", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class DepthMessage:
    """A `StoredImage` of depth in a message, in millimetres, 0 where unknown."""

    log: Log
    topic: Topic
    entry: Entry

    @property
    def name(self) -> str:
        """Topic and log time, as shown by other tools."""
        return f"{self.log.path}: {self.topic.name} logged at {self.entry.log_ns} ns"

    def read(self, colour: bool = False) -> Pixels:
        """Depth in millimetres, as uint16 or float32; `colour` has no effect."""
        try:
            message = self.topic.codec.decode(self.log.read(self.entry))
            if isinstance(message, ImageMessage):
                return _millimetres(message)
        except SourceError as error:
            raise SourceError(f"depth image {self.name}: {error}") from error
        assert isinstance(message, CompressedImageMessage)
        data = message.data
        has_header = not data.startswith(_PNG) and data[_HEADER_BYTES:].startswith(_PNG)
        return decode_image(data[_HEADER_BYTES:] if has_header else data, self.name)


def depth_topics(topics: Sequence[Topic]) -> list[Topic]:
    """Candidates for depth topics, by name."""
    kinds = (ImageMessage, CompressedImageMessage)
    return [
        topic
        for topic in topics
        if issubclass(topic.codec.kind, kinds) and _NAMED_DEPTH.search(topic.name)
    ]


def find_depth(
    log: Log,
    topics: Sequence[Topic],
    frame: str,
    entries: Mapping[str, Sequence[Entry]],
) -> list[Shot] | None:
    """The depth images registered to a camera, which have its frame; None if there are none."""
    for topic in topics:
        listed = entries[topic.name]
        first = next(filter(None, (_frame(log, topic, entry) for entry in listed[:10])), None)
        if first is not None and first == frame:
            return _list_depth(log, topic, listed)
        _log.debug("%s not used: frame %s, but camera frame %s", topic.name, first, frame)
    return None


def _list_depth(log: Log, topic: Topic, entries: Sequence[Entry]) -> list[Shot]:
    return list_shots(log, topic, entries, lambda n: DepthMessage(log, topic, entries[n]))


def _frame(log: Log, topic: Topic, entry: Entry) -> str | None:
    try:
        message = topic.codec.decode(log.read(entry))
    except VoError:
        return None
    return str(getattr(message, "frame", "")).lstrip("/")


def _millimetres(message: ImageMessage) -> Pixels:
    if message.pixel_format.strip().upper() != "32FC1":
        return grey_pixels(message)
    height, width = message.height, message.width
    step = message.step or 4 * width
    if min(height, width) < 1 or step < 4 * width or len(message.data) < height * step:
        raise SourceError(f"{width}x{height} pixels do not fit {len(message.data)} bytes")
    stored = np.dtype(">f4" if message.big_endian else "<f4")
    metres = np.ndarray((height, width), stored, message.data, strides=(step, 4))
    finite = np.where(np.isfinite(metres), metres, 0.0).astype(np.float32)
    return cast("Pixels", finite * np.float32(UNITS_PER_METRE))
