"""Inertial sensors in a log; gyroscope and accelerometer may be on separate topics."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import astuple, fields
from functools import cached_property

import numpy as np

from vo.base.errors import SourceError, VoError
from vo.base.types import Floats, ImuNoise, Ints
from vo.recordings.formats.calibration import ImuCalibration
from vo.recordings.formats.messages import ImuMessage
from vo.recordings.formats.stamp_units import MAX_STAMP_NS
from vo.recordings.sources.imu import (
    Imu,
    ImuSamples,
    joined_samples,
    make_samples,
    time_slice,
)
from vo.recordings.sources.logs.images import sorted_by_stamp
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.realsense_bag import stream_of

_log = logging.getLogger(__name__)

_PARTS = 20
_GYRO = re.compile(r"(?<![a-z])gyro(?![a-z])", re.IGNORECASE)


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
        self.noise: ImuNoise | None = given.noise or _recorded_noise(log, topic.name)
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
                return self._find_extrinsics(stream_of(self.name) or message.frame.lstrip("/"))
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


def _recorded_noise(log: Log, topic: str) -> ImuNoise | None:
    """The noise that `vo convert` and `vo synth` store with an MCAP file."""
    facts = log.metadata(topic.strip("/"))
    try:
        noise = ImuNoise(*(float(facts[each.name]) for each in fields(ImuNoise)))
    except (KeyError, ValueError):
        return None
    return noise if all(0 <= value < math.inf for value in astuple(noise)) else None


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


class PairedImu:
    """An `Imu` of two topics; accelerations are interpolated at the stamps of the gyroscope."""

    def __init__(self, gyro: LogImu, accel: LogImu) -> None:
        """Join two sensors that are rigidly connected."""
        self.name = f"{gyro.name} with {accel.name}"
        self.noise: ImuNoise | None = gyro.noise
        self.time_offset_s = gyro.time_offset_s
        self._gyro = gyro
        self._accel = accel

    @property
    def stamps_ns(self) -> Ints:
        """See `Imu.stamps_ns`: stamps of the gyroscope between two accelerations."""
        gyro_ns, accel_ns = self._gyro.stamps_ns, self._accel.stamps_ns
        if not len(accel_ns):
            return gyro_ns[:0]
        return gyro_ns[time_slice(gyro_ns, int(accel_ns[0]), int(accel_ns[-1]))]

    @property
    def cam0_from_imu(self) -> Floats | None:
        """See `Imu.cam0_from_imu`: pose of the gyroscope."""
        return self._gyro.cam0_from_imu

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """See `Imu.read`; damaged samples cause a warning."""
        stamps_ns = self.stamps_ns[time_slice(self.stamps_ns, first_ns, last_ns)]
        if not len(stamps_ns):
            return ImuSamples(stamps_ns, np.empty((0, 3)), np.empty((0, 3)))
        accel_ns = self._accel.stamps_ns
        before = int(np.searchsorted(accel_ns, stamps_ns[0], side="right")) - 1
        after = int(np.searchsorted(accel_ns, stamps_ns[-1]))
        accel = self._accel.read(int(accel_ns[before]), int(accel_ns[after]))
        return joined_samples(self._gyro.read(int(stamps_ns[0]), int(stamps_ns[-1])), accel)

    def read_some(self, max_samples: int) -> ImuSamples:
        """See `Imu.read_some`: one part from the middle."""
        stamps = self.stamps_ns
        if len(stamps) <= max_samples:
            return self.read()
        start = (len(stamps) - max_samples) // 2
        return self.read(int(stamps[start]), int(stamps[start + max_samples - 1]))


def log_imus(
    log: Log,
    topics: Sequence[Topic],
    find_extrinsics: Callable[[str], Floats | None],
    given: ImuCalibration | None = None,
) -> list[Imu]:
    """The inertial sensors of a log in the order of topics; gyro and accel topics are joined."""
    single = {topic.name: LogImu(log, topic, find_extrinsics, given) for topic in topics}
    partners = {
        name: _GYRO.sub("Accel" if "Gyro" in name else "accel", name)
        for name in single
        if _GYRO.search(name)
    }
    partners = {gyro: accel for gyro, accel in partners.items() if accel in single}
    return [
        PairedImu(imu, single[partners[name]]) if name in partners else imu
        for name, imu in single.items()
        if name not in partners.values()
    ]
