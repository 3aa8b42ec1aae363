"""Inertial sensors in a log."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from vo.base.errors import SourceError, VoError
from vo.base.types import Floats, ImuNoise, Ints
from vo.recordings.formats.calibration import ImuCalibration
from vo.recordings.formats.messages import ImuMessage
from vo.recordings.formats.stamp_units import MAX_STAMP_NS
from vo.recordings.sources.imu import ImuSamples, make_samples, time_slice
from vo.recordings.sources.logs.images import sorted_by_stamp
from vo.recordings.sources.logs.log import Entry, Log, Topic

_log = logging.getLogger(__name__)

_PARTS = 20


class LogImu:
    """An `Imu` in the messages of a topic, which are listed and read on demand."""

    def __init__(
        self,
        log: Log,
        topic: Topic,
        find_extrinsics: Callable[[str], Floats | None],
        given: ImuCalibration | None = None,
    ) -> None:
        """Store the topic; nothing is read yet.

        `find_extrinsics`: finds cam0_from_imu or None, given the frame of the sensor.
        """
        self.name = topic.name
        given = given or ImuCalibration()
        self.noise: ImuNoise | None = given.noise
        self.time_offset_s = given.time_offset_s
        self._given = given.cam0_from_imu
        self._log = log
        self._topic = topic
        self._find_extrinsics = find_extrinsics

    @property
    def stamps_ns(self) -> Ints:
        """See `Imu.stamps_ns`."""
        return self._listed[0]

    @cached_property
    def cam0_from_imu(self) -> Floats | None:
        """See `Imu.cam0_from_imu`."""
        if self._given is not None:
            return self._given
        for entry in self._listed[1]:
            message = self._decode(entry)
            if message is not None:
                return self._find_extrinsics(message.frame.lstrip("/"))
        return None

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """See `Imu.read`; damaged samples cause a warning."""
        stamps_ns, entries = self._listed
        rows = time_slice(stamps_ns, first_ns, last_ns)
        return self._samples(range(len(entries))[rows])

    def read_some(self, max_samples: int) -> ImuSamples:
        """See `Imu.read_some`; damaged samples cause a warning."""
        count = len(self.stamps_ns)
        if count <= max_samples:
            return self.read()
        length = max_samples // _PARTS
        firsts = [i * (count - length) // (_PARTS - 1) for i in range(_PARTS)]
        return self._samples([row for first in firsts for row in range(first, first + length)])

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
                "%s: %d of %d samples are damaged or not finite and are skipped",
                self.name,
                read.unreadable,
                len(rows),
            )
        return read

    @cached_property
    def _listed(self) -> tuple[Ints, Sequence[Entry]]:
        """Increasing stamps, and the message of each."""
        entries = self._log.entries([self.name])[self.name]
        ordered = sorted_by_stamp(self._log, self._topic, entries)
        ordered = [(stamp, row) for stamp, row in ordered if stamp <= MAX_STAMP_NS]
        stamps = np.array([stamp for stamp, _ in ordered], dtype=np.int64)
        kept, first = np.unique(stamps, return_index=True)
        if len(kept) < len(stamps):
            repeated = len(stamps) - len(kept)
            _log.warning("%s: %d samples repeat a stamp and are skipped", self.name, repeated)
        return kept, [entries[ordered[row][1]] for row in first.tolist()]

    def _decode(self, entry: Entry) -> ImuMessage | None:
        try:
            message = self._topic.codec.decode(self._log.read(entry))
        except VoError:
            return None
        return message if isinstance(message, ImuMessage) else None


def imu_topics(topics: Sequence[Topic], named: str | None = None) -> list[Topic]:
    """Topics of inertial sensors, by number of samples; a topic given by the user comes first."""
    found = [topic for topic in topics if issubclass(topic.codec.kind, ImuMessage)]
    found.sort(key=lambda topic: (-topic.count, topic.name))
    if named is None:
        return found
    chosen = [topic for topic in found if topic.name.strip("/") == named.strip("/")]
    if not chosen:
        known = ", ".join(topic.name for topic in found) or "none"
        raise SourceError(f"{named} is not the topic of an inertial sensor; such topics: {known}")
    return [*chosen, *(topic for topic in found if topic not in chosen)]
