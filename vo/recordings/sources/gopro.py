"""Inertial sensor, positions, exposures and settings that GoPro cameras write into their videos."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats, Ints
from vo.recordings.formats.gpmf import Entry, Stream, entries, read_streams
from vo.recordings.formats.mp4_boxes import Mp4, Payload, read_mp4
from vo.recordings.formats.positions import SIGMA_PER_DOP_M, PositionTable
from vo.recordings.sources.imu import ImuSamples, joined_samples, make_samples

RAW_SUFFIX = ".raw"
_MAX_RAW_BYTES = 2**28
_PAYLOAD_S = 1.001  # of a raw stream, which has no times
_MIN_FIX = 2  # of GPSF: 2 is latitude and longitude, 3 height as well
_CAM0_FROM_AXES = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
_PER_FRAME = ("SHUT", "ISOE", "WBAL")


@dataclass(frozen=True, eq=False)
class GoPro:
    """A video, or a raw stream, with its telemetry.

    Attributes:
        streams: samples of each sensor by their key.
    """

    mp4: Mp4
    streams: dict[str, Stream]

    def stamps_ns(self, key: str) -> Ints:
        """(N,) times of the samples of a stream in the video."""
        per_frame = next((self.streams[k] for k in _PER_FRAME if k in self.streams), None)
        return self.streams[key].stamps_ns(per_frame)

    @cached_property
    def settings(self) -> dict[str, Entry]:
        """Settings of the camera, such as VFOV (lens) and EISE (stabilisation)."""
        data = self.mp4.user_data.get(b"GPMF", b"")
        devices = [each for each in entries(data) if each.key == "DEVC"]
        return {each.key: each for device in devices[:1] for each in entries(device.data)}

    def text(self, key: str) -> str:
        """A setting of characters, empty if it is missing."""
        return self.settings[key].text if key in self.settings else ""

    def number(self, key: str) -> float:
        """A setting that is a number, 0 if it is missing."""
        rows = self.settings[key].rows() if key in self.settings else np.zeros((0, 0))
        return float(rows[0, 0]) if rows.size else 0.0

    @property
    def is_stabilised(self) -> bool:
        """Whether the images were turned against the camera (HyperSmooth)."""
        return self.text("EISE") == "Y"

    @property
    def cam0_from_imu(self) -> Floats | None:
        """(4, 4) pose of the sensor, taken to be at the camera; None of stabilised images."""
        return None if self.is_stabilised else make_transform(_CAM0_FROM_AXES, np.zeros(3))

    @property
    def readout_s(self) -> float:
        """Time from the first to the last row of an image, 0 if it is unknown."""
        found_ms = self.number("SROT")
        return 1e-3 * found_ms if 0.0 < found_ms < 100.0 else 0.0

    @property
    def has_imu(self) -> bool:
        """Whether there are rates and accelerations."""
        return {"GYRO", "ACCL"} <= self.streams.keys()

    def imu(self) -> ImuSamples:
        """Samples along the camera's axes X, Y and Z; accelerations at the times of the rates."""
        gyro, accel = (self.streams[key].in_axes() for key in ("GYRO", "ACCL"))
        zero = np.zeros_like
        return joined_samples(
            make_samples(self.stamps_ns("GYRO").tolist(), np.hstack([gyro, zero(gyro)]), 0),
            make_samples(self.stamps_ns("ACCL").tolist(), np.hstack([zero(accel), accel]), 0),
        )

    def positions(self) -> PositionTable | None:
        """Positions with a fix at times in the video; None without a receiver."""
        key = next((each for each in ("GPS9", "GPS5") if each in self.streams), None)
        if key is None:
            return None
        stream, stamps = self.streams[key], self.stamps_ns(key)
        rows, (fix, sigma_m) = stream.rows, _quality(stream, key)
        has_fix = (fix >= _MIN_FIX) & np.isfinite(rows[:, :3]).all(axis=1)
        if not has_fix.any():
            return None
        unique, first = np.unique(stamps[has_fix], return_index=True)
        return PositionTable(unique, rows[has_fix][first, :3], sigma_m[has_fix][first], True)


def _quality(stream: Stream, key: str) -> tuple[Floats, Floats]:
    """Kind of fix and standard deviation in metres, (N,) each; of GPS5 the same in a payload."""
    if key == "GPS9":
        dop, fix = stream.rows[:, 7], stream.rows[:, 8]
        return fix, SIGMA_PER_DOP_M * dop
    counts = [len(block.values) for block in stream.blocks]
    known = [(b.number("GPSF", 0.0), 0.01 * b.number("GPSP", np.nan)) for b in stream.blocks]
    table = np.repeat(np.array(known), counts, axis=0)
    return table[:, 0], SIGMA_PER_DOP_M * table[:, 1]


def open_gopro(path: Path) -> GoPro | None:
    """The telemetry of a video of a GoPro camera, or of a raw stream; None without any."""
    if path.suffix.lower() == RAW_SUFFIX:
        with path.open("rb") as file:
            data = file.read(_MAX_RAW_BYTES)
        devices = [each.data for each in entries(data) if each.key == "DEVC"]
        count = sum(each[:12] == devices[0][:12] for each in devices)  # DVID
        mp4, payloads = Mp4(path), [Payload(0.0, _PAYLOAD_S * count, data)]
    else:
        mp4 = read_mp4(path)
        payloads = mp4.payloads("gpmd")
    streams = read_streams(payloads)
    return GoPro(mp4, streams) if streams or b"GPMF" in mp4.user_data else None
