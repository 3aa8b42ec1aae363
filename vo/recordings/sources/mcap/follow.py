"""MCAP files as recordings, also while they are being written."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path

from vo.base.errors import SourceError
from vo.base.types import Mode
from vo.recordings.sources.images import StoredImage
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.choice import IMAGE_KINDS, choose_topics
from vo.recordings.sources.logs.images import image_factory
from vo.recordings.sources.logs.log import MessageSpan, Topic
from vo.recordings.sources.logs.opening import open_log
from vo.recordings.sources.logs.stamps import stamp_of
from vo.recordings.sources.mcap.contents import (
    empty_contents,
    index_truncated_chunk,
    scan_new_records,
)
from vo.recordings.sources.mcap.file import McapFile, read_error, warn_of_damage
from vo.recordings.sources.mcap.records import MAGIC
from vo.recordings.sources.pairing import MAX_TOLERANCE_NS
from vo.recordings.sources.source import Recording

_log = logging.getLogger(__name__)

END_TIMEOUT_S = 10.0
"""A file that has not grown for this time is considered complete."""

_POLL_S = 0.05
_MIN_IMAGES = 10
"""Images before opening; calibration and transforms may be written after the first images."""


class GrowingFile:
    """An MCAP file that grows; it ends when it is closed or has stopped growing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._contents = empty_contents()
        self._size = 0
        self._grew_at = time.monotonic()
        self.has_ended = False

    def wait_for_cameras(self) -> McapFile:
        """Wait until a topic has some images, and open the file."""
        while not self.has_ended and self._max_image_count() < _MIN_IMAGES:
            self.wait()
        return McapFile(self.path, self._contents)

    def wait(self) -> None:
        """Scan new records, or wait for a short time if there are none."""
        try:
            size = self.path.stat().st_size
            with self.path.open("rb") as stream:
                if size > self._size:
                    self._check_magic(stream.read(len(MAGIC)))
                    scan_new_records(self._contents, stream, size)
                    self._size, self._grew_at = size, time.monotonic()
                    self.has_ended = self._contents.damage is None
                elif time.monotonic() - self._grew_at > END_TIMEOUT_S:
                    index_truncated_chunk(self._contents, stream, size)
                    warn_of_damage(self.path, self._contents)
                    self.has_ended = True
                else:
                    time.sleep(_POLL_S)
        except OSError as error:
            raise read_error(self.path, error) from error

    def _check_magic(self, first: bytes) -> None:
        if not MAGIC.startswith(first):
            raise SourceError(f"{self.path} is not an MCAP file: its first bytes differ")

    def _max_image_count(self) -> int:
        index = self._contents.index
        counts = [0]
        for number in index.channels:
            codec = index.codec(number)
            if codec is not None and issubclass(codec.kind, IMAGE_KINDS):
                counts.append(index.statistics.get(number, MessageSpan()).count)
        return max(counts)


class ArrivingFrames:
    """Frames of a growing file, as they arrive."""

    def __init__(
        self,
        growing: GrowingFile,
        file: McapFile,
        left: Topic,
        right: Topic | None,
        right_offset_ns: int = 0,
    ) -> None:
        self._growing = growing
        self._file = file
        self._topics = [left] if right is None else [left, right]
        self._offset_ns = (0, right_offset_ns)  # to be added to stamps
        names = [topic.name for topic in self._topics]
        self._entries = [file.entries(names)[name] for name in names]
        self._images = [
            image_factory(file, topic, entries)
            for topic, entries in zip(self._topics, self._entries, strict=True)
        ]
        self._queued = [0] * len(self._topics)  # number of messages that have been queued
        self._queues: list[list[Shot]] = [[] for _ in self._topics]
        self._last_ns = -1

    def next_frames(self) -> list[tuple[Shot, StoredImage | None]] | None:
        """Wait for the next left images, with their right images; None at the end."""
        while True:
            self._queue_new_images()
            frames = self._ready()
            if frames:
                return frames
            if self._growing.has_ended:
                return None
            self._growing.wait()

    def _queue_new_images(self) -> None:
        for side, entries in enumerate(self._entries):
            for number in range(self._queued[side], len(entries)):
                shot = self._shot(side, number)
                if shot.stamp_ns > self._last_ns:
                    self._queues[side].append(shot)
            self._queued[side] = len(entries)
            self._queues[side].sort(key=lambda shot: shot.stamp_ns)

    def _shot(self, side: int, number: int) -> Shot:
        topic, entry = self._topics[side], self._entries[side][number]
        stamp_ns = stamp_of(self._file, topic, entry) or entry.log_ns
        stamp_ns += self._offset_ns[side]
        return Shot(stamp_ns, self._images[side](number), f"{self._file.path}: {topic.name}")

    def _ready(self) -> list[tuple[Shot, StoredImage | None]]:
        """Left images whose right image has arrived or can no longer arrive."""
        frames: list[tuple[Shot, StoredImage | None]] = []
        left = self._queues[0]
        rights = self._queues[1] if len(self._queues) > 1 else None
        while left:
            shot, partner = left[0], None
            if rights is not None:
                newest = rights[-1].stamp_ns if rights else -1
                if newest < shot.stamp_ns and not self._growing.has_ended:
                    break
                partner = _pop_partner(rights, shot.stamp_ns)
            left.pop(0)
            if shot.stamp_ns > self._last_ns:
                frames.append((shot, partner))
                self._last_ns = shot.stamp_ns
        return frames


def _pop_partner(rights: list[Shot], stamp_ns: int) -> StoredImage | None:
    """Remove and return the nearest right image within 5 ms, and drop those before it."""
    if not rights:
        return None
    nearest = min(range(len(rights)), key=lambda i: abs(rights[i].stamp_ns - stamp_ns))
    if abs(rights[nearest].stamp_ns - stamp_ns) > MAX_TOLERANCE_NS:
        return None
    partner = rights[nearest].image
    del rights[: nearest + 1]
    return partner


def open_growing(
    path: Path,
    calibration: Path | None,
    mode: Mode,
    topics: Sequence[str] = (),
    right_offset_ns: int | None = None,
) -> Recording:
    """Open a file that is still being written; arguments as of `open_log`.

    Frames are read as they arrive, until the file is closed or has stopped growing.
    """
    growing = GrowingFile(path)
    file = growing.wait_for_cameras()
    source = open_log(file, "mcap", calibration, mode, topics, right_offset_ns, is_rig=False)
    choice = choose_topics(file.topics, topics, mode)
    right = choice.right if source.rig.is_stereo else None
    arriving = ArrivingFrames(growing, file, choice.left, right, source.right_offset_ns)
    source.follow(arriving.next_frames)
    return source
