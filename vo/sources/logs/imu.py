"""Inertial sensors in a log."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from vo.errors import SourceError, VoError
from vo.formats.messages import ImuMessage
from vo.sources.imu import ImuSamples, make_samples, rows_between
from vo.sources.listing import LARGEST_NS
from vo.sources.logs.images import in_order
from vo.sources.logs.log import Entry, Log, Topic
from vo.types import Floats, ImuNoise, Ints

_log = logging.getLogger(__name__)

_STRETCHES = 20


class LogImu:
    """An `Imu` in messages of a topic; they are not even listed before they are asked for."""

    def __init__(self, log: Log, topic: Topic, place: Callable[[str], Floats | None]) -> None:
        """Take what will be read.

        Args:
            log: where the messages are.
            topic: theirs.
            place: given the sensor's frame, cam0_from_imu or None.
        """
        self.name = topic.name
        self.noise: ImuNoise | None = None
        self._log = log
        self._topic = topic
        self._place = place

    @property
    def stamps_ns(self) -> Ints:
        """As `Imu.stamps_ns`."""
        return self._listed[0]

    @cached_property
    def cam0_from_imu(self) -> Floats | None:
        """As `Imu.cam0_from_imu`."""
        for entry in self._listed[1]:
            message = self._decode(entry)
            if message is not None:
                return self._place(message.frame.lstrip("/"))
        return None

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """As `Imu.read`; samples that are damaged are warned of."""
        stamps_ns, entries = self._listed
        rows = rows_between(stamps_ns, first_ns, last_ns)
        return self._samples(range(len(entries))[rows])

    def read_some(self, most: int) -> ImuSamples:
        """As `Imu.read_some`; warns as `read`."""
        count = len(self.stamps_ns)
        if count <= most:
            return self.read()
        stretch = most // _STRETCHES
        firsts = [i * (count - stretch) // (_STRETCHES - 1) for i in range(_STRETCHES)]
        return self._samples([row for first in firsts for row in range(first, first + stretch)])

    def _samples(self, rows: Sequence[int]) -> ImuSamples:
        stamps_ns, entries = self._listed
        stamps, values = [], []
        for row in rows:
            message = self._decode(entries[row])
            if message is not None:
                stamps.append(int(stamps_ns[row]))
                values.append([*message.gyro.tolist(), *message.accel.tolist()])
        read = make_samples(stamps, values, len(rows) - len(stamps))
        if read.unreadable:
            _log.warning(
                "%s: %d of %d samples are damaged or not finite and are left out",
                self.name,
                read.unreadable,
                len(rows),
            )
        return read

    @cached_property
    def _listed(self) -> tuple[Ints, Sequence[Entry]]:
        """Stamps that increase, and the message of each."""
        entries = self._log.entries([self.name])[self.name]
        ordered = in_order(self._log, self._topic, entries)
        ordered = [(stamp, row) for stamp, row in ordered if stamp <= LARGEST_NS]
        stamps = np.array([stamp for stamp, _ in ordered], dtype=np.int64)
        kept, first = np.unique(stamps, return_index=True)
        if len(kept) < len(stamps):
            repeated = len(stamps) - len(kept)
            _log.warning("%s: %d samples repeat a stamp and are left out", self.name, repeated)
        return kept, [entries[ordered[row][1]] for row in first.tolist()]

    def _decode(self, entry: Entry) -> ImuMessage | None:
        try:
            message = self._topic.codec.decode(self._log.read(entry))
        except VoError:
            return None
        return message if isinstance(message, ImuMessage) else None


def imu_topics(topics: Sequence[Topic], named: str | None = None) -> list[Topic]:
    """Topics of inertial sensors: the one that the user named, or else the fullest first.

    Raises:
        SourceError: the user named one that there is not.
    """
    found = [topic for topic in topics if issubclass(topic.codec.kind, ImuMessage)]
    found.sort(key=lambda topic: (-topic.count, topic.name))
    if named is None:
        return found
    wanted = [topic for topic in found if topic.name.strip("/") == named.strip("/")]
    if not wanted:
        known = ", ".join(topic.name for topic in found) or "none"
        raise SourceError(f"{named} is no topic of an inertial sensor; there is {known}")
    return [*wanted, *(topic for topic in found if topic not in wanted)]
