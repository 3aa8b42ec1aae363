"""Positions that come with a video: subtitles and flight logs of drones, and GPX of phones."""

from __future__ import annotations

import csv
import logging
import re
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.recordings.formats.positions import PositionTable, position_lines, position_table

_log = logging.getLogger(__name__)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_CUE = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->")
_LATITUDE = re.compile(rf"latitude\s*:\s*{_NUMBER}", re.IGNORECASE)
_LONGITUDE = re.compile(rf"longt?itude\s*:\s*{_NUMBER}", re.IGNORECASE)
_PAIR = re.compile(rf"GPS\s*\(\s*{_NUMBER},\s*{_NUMBER}")  # longitude first
_HEIGHT = re.compile(rf"(?:abs_alt|altitude|BAROMETER|\bH)\s*[: ]\s*{_NUMBER}")
_POINT = re.compile(r"<(trkpt|rtept|wpt)\b([^>]*)>(.*?)</\1>", re.DOTALL)
_SIDES = (rf"\blat\s*=\s*[\"']{_NUMBER}", rf"\blon\s*=\s*[\"']{_NUMBER}")
_TIME = re.compile(r"<time>\s*([^<]+?)\s*</time>")
_ELEVATION = re.compile(rf"<ele>\s*{_NUMBER}")

_FLIGHT_TIME = re.compile(r"time\(millisecond\)|(?:\w+\.)?flytime\s*\[s\]", re.IGNORECASE)
_HEIGHTS = ("altitude_above_sealevel", "altitude", "height_above_takeoff", "height")

_Point = tuple[int, float, float, float]


def read_track(path: Path) -> PositionTable | None:
    """Read an SRT, GPX or flight log, whatever its suffix; None for another one.

    Times of SRT are those in the video, and of a log that has one video. Points without a time or
    a fix are left out.
    """
    text = "\n".join(position_lines(path))
    read: Callable[[str], Iterator[_Point]]
    if "<gpx" in text[:2000]:
        kind, read = "GPX", _gpx
    elif _CUE.search(text[:2000]):
        kind, read = "SRT", _srt
    elif _FLIGHT_TIME.search(text[:4000].partition("latitude")[0]):
        kind, read = "a flight log", _flight_log
    else:
        return None
    points: Sequence[_Point] = list(read(text))
    if not points:
        raise SourceError(f"{path} is {kind} without positions that have times; give another file")
    stamps_ns = np.array([point[0] for point in points], np.int64)
    values = np.array([point[1:] for point in points])
    return position_table(path, stamps_ns, values, np.full(len(points), np.nan), True)


def _srt(text: str) -> Iterator[_Point]:
    begins = [*_CUE.finditer(text)]
    ends = [*(cue.start() for cue in begins[1:]), len(text)]
    for cue, end in zip(begins, ends, strict=True):
        body = text[cue.end() : end]
        latitude, longitude = _LATITUDE.search(body), _LONGITUDE.search(body)
        pair, height = _PAIR.search(body), _HEIGHT.search(body)
        if latitude and longitude:
            position = float(latitude[1]), float(longitude[1])
        elif pair:
            position = float(pair[2]), float(pair[1])
        else:
            continue
        if any(position):  # (0, 0) is no fix
            hours, minutes, seconds, milliseconds = map(int, cue.groups())
            stamp_ms = ((hours * 60 + minutes) * 60 + seconds) * 1000 + milliseconds
            yield stamp_ms * 1_000_000, *position, float(height[1]) if height else 0.0


def _flight_log(text: str) -> Iterator[_Point]:
    """Rows of a log as AirData or DJI's viewers export it: milliseconds or seconds of the flight.

    Source: AirData UAV, "CSV export" (`time(millisecond)`, `altitude_above_seaLevel(feet)`,
        `isVideo`), and logs with `OSD.flyTime [s]`, `OSD.altitude [ft]`.
    """
    lines = [line for line in text.splitlines() if not line.startswith("sep=")]
    names = [re.sub(r"\s", "", name).lower() for name in next(csv.reader(lines[:1]), [])]
    named = {re.sub(r"^\w+\.|[\[(].*", "", name): n for n, name in reversed([*enumerate(names)])}
    time = next(n for n, name in enumerate(names) if _FLIGHT_TIME.fullmatch(name))
    to_ms = 1.0 if "milli" in names[time] else 1000.0
    height = next((named[key] for key in _HEIGHTS if key in named), None)
    to_m = 0.3048 if height is not None and re.search(r"f(ee)?t", names[height]) else 1.0
    points: list[tuple[_Point, bool]] = []
    for row in csv.reader(lines[1:]):
        try:
            position = float(row[named["latitude"]]), float(row[named["longitude"]])
            stamp_ns = round(to_ms * float(row[time]) * 1e6)
            metres = 0.0 if height is None else to_m * float(row[height] or 0.0)
            is_video = "isvideo" in named and row[named["isvideo"]].lower() in ("1", "true")
        except (ValueError, IndexError, KeyError):
            continue
        if any(position):  # (0, 0) is no fix
            points.append(((stamp_ns, *position, metres), is_video))
    filmed = [is_video for _, is_video in points]
    begins = [n for n, now in enumerate(filmed) if now and not (n and filmed[n - 1])]
    if len(begins) != 1:
        _log.warning("the flight log has %d videos: times count from its start", len(begins))
        yield from (point for point, _ in points)
        return
    start_ns = points[begins[0]][0][0]
    yield from ((p[0] - start_ns, *p[1:]) for p, is_video in points if is_video)


def _gpx(text: str) -> Iterator[_Point]:
    for point in _POINT.finditer(text):
        latitude, longitude = (re.search(side, point[2]) for side in _SIDES)
        time, height = _TIME.search(point[3]), _ELEVATION.search(point[3])
        try:
            stamp = None if time is None else datetime.fromisoformat(time[1])
        except ValueError:
            continue
        if latitude and longitude and stamp is not None:
            since = stamp.replace(tzinfo=stamp.tzinfo or UTC) - _EPOCH
            stamp_ns = since // timedelta(microseconds=1) * 1000
            yield (
                stamp_ns,
                float(latitude[1]),
                float(longitude[1]),
                float(height[1] if height else 0),
            )
