"""GPMF, the telemetry of GoPro cameras: streams of samples with their times.

Source: GoPro, "GPMF introduction" (github.com/gopro/gpmf-parser, README): key, type, size and
repeat; SCAL, TYPE, ORIN; times from TSMP and the payloads, or from STMP.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, Ints
from vo.recordings.formats.mp4_boxes import Payload

_FORMATS = {
    **{"b": "i1", "B": "u1", "s": "i2", "S": "u2", "l": "i4", "L": "u4", "j": "i8", "J": "u8"},
    **{"f": "f4", "d": "f8", "q": "i4", "Q": "i8"},
}
_FIXED = {"q": 2.0**-16, "Q": 2.0**-32}
_FIRST_ORDER = "ZXY"  # of axes, where ORIN does not say it: HERO5, Fusion, Karma
_AXES = "XYZ"
_CLOCKS = (("STMP", 1e-6), ("TICK", 1e-3))  # of the first sample of a block, with units


class Entry(NamedTuple):
    """A key with its value: type, size of one element, and bytes."""

    key: str
    kind: str
    size: int
    data: bytes

    @property
    def text(self) -> str:
        """Of a value of characters."""
        return self.data.rstrip(b"\0").decode("latin-1").strip()

    def rows(self, complex_type: str = "") -> Floats:
        """(N, K) numbers; none of an unknown type, and NaN for what is no number.

        Complex elements, as of GPS9, are of the types that TYPE lists before.
        """
        types = complex_type if self.kind == "?" else self.kind
        if self.kind != "?" and self.kind in _FORMATS:
            width = np.dtype(_FORMATS[self.kind]).itemsize
            types = self.kind * (self.size // width)
        known = [(f"f{n}", f">{_FORMATS[t]}") for n, t in enumerate(types) if t in _FORMATS]
        if not types or len(known) < len(types) or np.dtype(known).itemsize != self.size:
            return np.zeros((0, 0))
        table = np.frombuffer(self.data[: len(self.data) // self.size * self.size], known)
        scaled = [
            table[name].astype(np.float64) * _FIXED.get(each, 1.0)
            for (name, _), each in zip(known, types, strict=True)
        ]
        return np.stack(scaled, axis=1)


def entries(data: bytes) -> Iterator[Entry]:
    """The keys of one level, to the first that is damaged."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, repeat = struct.unpack_from(">4scBH", data, at)
        length = size * repeat
        if key == b"\0\0\0\0" or at + 8 + length > len(data):
            return
        name = "" if kind == b"\0" else kind.decode("latin-1")
        yield Entry(key.decode("latin-1"), name, size, data[at + 8 : at + 8 + length])
        at += 8 + -(-length // 4) * 4


class Block(NamedTuple):
    """The samples of a stream in one payload.

    Attributes:
        start_s: of the payload in the video.
        seconds: its length.
        values: (N, K), scaled as SCAL says.
        facts: other keys, such as STNM, SIUN and ORIN.
    """

    start_s: float
    seconds: float
    values: Floats
    facts: dict[str, Entry]

    def number(self, key: str, missing: float) -> float:
        """The first number of a key."""
        rows = self.facts[key].rows() if key in self.facts else None
        return missing if rows is None or not rows.size else float(rows[0, 0])


@dataclass(frozen=True)
class Stream:
    """The samples of one sensor."""

    blocks: list[Block]

    @property
    def rows(self) -> Floats:
        """(N, K) all values."""
        return np.concatenate([block.values for block in self.blocks])

    def in_axes(self) -> Floats:
        """(N, 3) values along the camera's axes X, Y and Z, by ORIN."""
        given = self.blocks[0].facts.get("ORIN")
        order = _FIRST_ORDER if given is None else given.text
        if sorted(order.upper()) != list(_AXES):
            order = _FIRST_ORDER
        signs = np.array([1.0 if letter.isupper() else -1.0 for letter in order])
        columns = [order.upper().index(axis) for axis in _AXES]
        return np.asarray((self.rows[:, :3] * signs)[:, columns])

    def stamps_ns(self, video: Stream | None = None) -> Ints:
        """(N,) times of the samples in the video.

        `video`: a stream with a sample for each image, such as SHUT: where both have STMP or TICK,
        its first one is that of the first image. Else payloads have the times.
        """
        times = self._block_times(video)
        counts = np.array([len(block.values) for block in self.blocks])
        seconds = self.blocks[-1].seconds
        if len(times) > 1:
            seconds = counts[-1] * float(times[-1] - times[-2]) / counts[-2]
        firsts = np.append(np.cumsum(counts) - counts, counts.sum())
        found = np.interp(np.arange(counts.sum()), firsts, np.append(times, times[-1] + seconds))
        return np.asarray(np.rint(found * 1e9).astype(np.int64))

    def _block_times(self, video: Stream | None) -> Floats:
        """Seconds in the video of the first sample of each block."""
        for key, unit_s in _CLOCKS:
            zero_s = None if video is None else video._clock_s(key, unit_s)
            times = self._clock_s(key, unit_s)
            if zero_s is not None and times is not None:
                return np.asarray(times - zero_s[0])
        return _smoothed(np.array([block.start_s for block in self.blocks]), self.blocks, np.inf)

    def _clock_s(self, key: str, unit_s: float) -> Floats | None:
        """The same on the camera's clock; None if it is missing or jumps."""
        times = unit_s * np.array([block.number(key, math.nan) for block in self.blocks])
        if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
            return None
        return _smoothed(times, self.blocks, 2.0 * unit_s)


def _smoothed(times: Floats, blocks: list[Block], most_s: float) -> Floats:
    """Times on a line over the samples, if they are rounded only: within `most_s` of it."""
    if len(times) < 2:
        return times
    counts = np.array([len(block.values) for block in blocks])
    first = np.cumsum(counts) - counts
    line = np.polyval(np.polyfit(first, times - times[0], 1), first) + times[0]
    return np.asarray(line if np.abs(line - times).max() <= most_s else times)


def read_streams(payloads: Iterable[Payload]) -> dict[str, Stream]:
    """Streams by the key of their samples, such as GYRO, of the first device, the camera.

    The seconds of a payload are those of all its parts, if the device is in it several times.
    """
    streams: dict[str, Stream] = {}
    for payload in payloads:
        devices = [list(entries(e.data)) for e in entries(payload.data) if e.key == "DEVC"]
        names = [next((e.data for e in each if e.key == "DVID"), b"") for each in devices]
        parts = [each for each, name in zip(devices, names, strict=True) if name == names[0]]
        for number, part in enumerate(parts):
            seconds = payload.seconds / len(parts)
            start_s = payload.start_s + number * seconds
            for each in part:
                if each.key == "STRM" and not each.kind:
                    _add(streams, start_s, seconds, list(entries(each.data)))
    return streams


def _add(streams: dict[str, Stream], start_s: float, seconds: float, listed: list[Entry]) -> None:
    """Add the samples of a stream, which are its last key."""
    if not listed or not listed[-1].kind:
        return
    key = listed[-1].key
    facts = {each.key: each for each in listed if each.key != key}
    kind = facts["TYPE"].text if "TYPE" in facts else ""
    parts = [each.rows(kind) for each in listed if each.key == key]
    found = np.concatenate([part for part in parts if part.size] or [np.zeros((0, 0))])
    scale = facts["SCAL"].rows().reshape(-1) if "SCAL" in facts else np.ones(1)
    stream = streams.setdefault(key, Stream([]))
    width = found.shape[1] if not stream.blocks else stream.blocks[0].values.shape[1]
    if found.size and found.shape[1] == width and len(scale) in (1, width) and scale.all():
        stream.blocks.append(Block(start_s, seconds, found / scale, facts))
    elif not stream.blocks:
        del streams[key]
