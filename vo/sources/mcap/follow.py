"""An MCAP file that is still being written, followed to its end."""

from __future__ import annotations

import logging
import time
from pathlib import Path

from vo.errors import SourceError
from vo.sources.images import StoredImage
from vo.sources.listing import Shot
from vo.sources.logs.choice import IMAGE_KINDS
from vo.sources.logs.images import image_maker, stamp_of
from vo.sources.logs.log import Topic
from vo.sources.mcap.book import Tally
from vo.sources.mcap.file import McapFile, unreadable, warn_of_damage
from vo.sources.mcap.records import MAGIC
from vo.sources.mcap.survey import begin, go_on, salvage
from vo.sources.pairing import LARGEST_TOLERANCE_NS

_log = logging.getLogger(__name__)

PATIENCE_S = 10.0
"""How long a file may stand still before it counts as ended."""

_POLL_S = 0.05
_ENOUGH_IMAGES = 10
"""What says where the cameras are is written beside the first images, not always before them."""


class GrowingFile:
    """An MCAP file that grows; it has ended when it was closed or has not grown for a while."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._found = begin()
        self._size = 0
        self._grew_at = time.monotonic()
        self.has_ended = False

    def wait_for_cameras(self) -> McapFile:
        """Wait until there are some images of a topic, and give what there is by then.

        Raises:
            SourceError: it is no MCAP file, or it cannot be read.
        """
        while not self.has_ended and self._most_images() < _ENOUGH_IMAGES:
            self.wait()
        return McapFile(self.path, self._found)

    def wait(self) -> None:
        """Wait a little and take in what came.

        Raises:
            SourceError: it is no MCAP file, or it cannot be read.
        """
        try:
            size = self.path.stat().st_size
            with self.path.open("rb") as stream:
                if size > self._size:
                    self._check_magic(stream.read(len(MAGIC)))
                    go_on(self._found, stream, size)
                    self._size, self._grew_at = size, time.monotonic()
                    self.has_ended = self._found.damage is None
                elif time.monotonic() - self._grew_at > PATIENCE_S:
                    salvage(self._found, stream, size)
                    warn_of_damage(self.path, self._found)
                    self.has_ended = True
                else:
                    time.sleep(_POLL_S)
        except OSError as error:
            raise unreadable(self.path, error) from error

    def _check_magic(self, first: bytes) -> None:
        if not MAGIC.startswith(first):
            raise SourceError(f"{self.path} does not begin like an MCAP file")

    def _most_images(self) -> int:
        book = self._found.book
        counts = [0]
        for number in book.channels:
            codec = book.codec(number)
            if codec is not None and issubclass(codec.kind, IMAGE_KINDS):
                counts.append(book.tallies.get(number, Tally()).count)
        return max(counts)


class Arrivals:
    """The images of a growing file, frame by frame, as they come."""

    def __init__(
        self, growing: GrowingFile, file: McapFile, left: Topic, right: Topic | None
    ) -> None:
        self._growing = growing
        self._file = file
        self._topics = [left] if right is None else [left, right]
        names = [topic.name for topic in self._topics]
        self._entries = [file.entries(names)[name] for name in names]
        self._images = [
            image_maker(file, topic, entries)
            for topic, entries in zip(self._topics, self._entries, strict=True)
        ]
        self._taken = [0] * len(self._topics)
        self._waiting: list[list[Shot]] = [[] for _ in self._topics]
        self._last_ns = -1

    def next_frames(self) -> list[tuple[Shot, StoredImage | None]] | None:
        """The next images with their partners, once they are there; None at the end."""
        while True:
            self._take_new()
            frames = self._ready()
            if frames:
                return frames
            if self._growing.has_ended:
                return None
            self._growing.wait()

    def _take_new(self) -> None:
        for side, entries in enumerate(self._entries):
            for number in range(self._taken[side], len(entries)):
                shot = self._shot(side, number)
                if shot.stamp_ns > self._last_ns:
                    self._waiting[side].append(shot)
            self._taken[side] = len(entries)
            self._waiting[side].sort(key=lambda shot: shot.stamp_ns)

    def _shot(self, side: int, number: int) -> Shot:
        topic, entry = self._topics[side], self._entries[side][number]
        stamp_ns = stamp_of(self._file, topic, entry) or entry.log_ns
        return Shot(stamp_ns, self._images[side](number), f"{self._file.path}: {topic.name}")

    def _ready(self) -> list[tuple[Shot, StoredImage | None]]:
        """Left images whose partner is there or can no longer come."""
        frames: list[tuple[Shot, StoredImage | None]] = []
        left = self._waiting[0]
        rights = self._waiting[1] if len(self._waiting) > 1 else None
        while left:
            shot, partner = left[0], None
            if rights is not None:
                newest = rights[-1].stamp_ns if rights else -1
                if newest < shot.stamp_ns and not self._growing.has_ended:
                    break
                partner = _take_partner(rights, shot.stamp_ns)
            left.pop(0)
            if shot.stamp_ns > self._last_ns:
                frames.append((shot, partner))
                self._last_ns = shot.stamp_ns
        return frames


def _take_partner(rights: list[Shot], stamp_ns: int) -> StoredImage | None:
    """The right image nearest in time, if it is near; it and those before are let go."""
    if not rights:
        return None
    nearest = min(range(len(rights)), key=lambda i: abs(rights[i].stamp_ns - stamp_ns))
    if abs(rights[nearest].stamp_ns - stamp_ns) > LARGEST_TOLERANCE_NS:
        return None
    partner = rights[nearest].image
    del rights[: nearest + 1]
    return partner
