"""Positions of another sensor, read from text, logs, and the recording of a run itself."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.geodesy import enu_from_geodetic, geodetic_from_enu
from vo.base.types import Floats, Ints
from vo.recordings.formats.foreign_files import foreign_message
from vo.recordings.formats.messages import PathMessage, PoseMessage, PositionFixMessage
from vo.recordings.formats.positions import PositionTable, is_nmea, read_nmea, read_position_csv
from vo.recordings.formats.track_files import read_track
from vo.recordings.formats.trajectory import has_stamps, read_trajectory
from vo.recordings.sources.gopro import RAW_SUFFIX
from vo.recordings.sources.logs.log import Log, Topic
from vo.recordings.sources.logs.poses import poses_on_topic
from vo.recordings.sources.logs.stamps import message_stamps
from vo.recordings.sources.motion_tracks import read_motion_track
from vo.recordings.sources.oxts import read_oxts_positions
from vo.recordings.sources.registry import (
    FORMATS,
    VIDEO_SUFFIXES,
    detect_format,
    open_container,
)

_log = logging.getLogger(__name__)
AUTO = "auto"
_ODOMETRY = ("nav_msgs/msg/Odometry", "nav_msgs/Odometry")
_METRES_PER_DEGREE = 111_320.0
_DIGITS = 9  # of degrees: a tenth of a millimetre
_MIN_GAPS = 3  # between rounded values
_MULTIPLE = 0.01
_TRACK_SUFFIXES = (".srt", ".SRT", ".gpx", ".GPX", ".nmea")
_KINDS = (PositionFixMessage, PoseMessage, PathMessage)


@dataclass(frozen=True, eq=False)
class Positions:
    """Positions in metres, in time order.

    Attributes:
        name: of the file or topic, for messages.
        source: `gps`, `odometry`, `positions` or `trajectory`.
        stamps_ns: (N,) increasing.
        xyz: (N, 3) metres; of GPS east, north and up of the origin.
        sigma_m: (N,) standard deviation along one axis, NaN where unknown.
        origin: (3,) latitude, longitude and height of the origin, None if it is unknown.
        is_time_of_day: whether the date is unknown.
    """

    name: str
    source: str
    stamps_ns: Ints
    xyz: Floats
    sigma_m: Floats
    origin: Floats | None = None
    is_time_of_day: bool = False

    @property
    def resolution_m(self) -> float:
        """Metres to which horizontal positions are rounded, 0 if that does not show."""
        metres = np.ones(2)
        values = self.xyz[:, :2]
        if self.origin is not None:
            values = geodetic_from_enu(self.xyz, self.origin)[:, :2]
            metres = _METRES_PER_DEGREE * np.array([1.0, np.cos(np.radians(self.origin[0]))])
        return max(_step(column) * unit for column, unit in zip(values.T, metres, strict=True))

    def shifted(self, offset_ns: int) -> Positions:
        """The same at later times."""
        return replace(self, stamps_ns=self.stamps_ns + offset_ns)


def _step(values: Floats) -> float:
    """The step of which all differences are multiples, 0 if there is none."""
    gaps = np.diff(np.unique(np.round(values, _DIGITS)))
    if len(gaps) < _MIN_GAPS:
        return 0.0
    step = float(gaps.min())
    is_multiple = np.abs(gaps / step - np.round(gaps / step)) < _MULTIPLE
    is_regular = len(gaps) == len(values) - 1 and np.ptp(gaps) < _MULTIPLE * step
    return step if is_multiple.all() and not is_regular else 0.0


def read_positions(given: str, recording: str | None = None) -> Positions:
    """Read positions.

    Args:
        given: a text file (NMEA, GPX, SRT of a drone, CSV with names of columns, or a trajectory),
            a log or `LOG:/TOPIC`, a folder of KITTI's `oxts` or the drive that has it; `auto`, or
            `auto:/TOPIC`, for the recording itself.
        recording: path of the recording, None if it has none.

    Raises:
        SourceError: the file is missing, damaged, or has no positions with times, or several.
    """
    path, wanted = located(given, recording, "positions")
    for folder in (path, path / "oxts"):
        if folder.name == "oxts" and (folder / "timestamps.txt").is_file():
            return _of_table(read_oxts_positions(folder), str(folder))
    if path.is_file() and path.suffix.lower() in (*VIDEO_SUFFIXES, RAW_SUFFIX):
        return _of_video(path)
    log = log_of(path)
    if log is not None:
        return _from_log(log, wanted)
    if path.is_dir():
        raise SourceError(
            f"{path} has no positions of another sensor (oxts, or a log); give a file"
        )
    return _from_text(path)


def located(given: str, recording: str | None, option: str) -> tuple[Path, str | None]:
    """File or folder of `FILE`, `LOG:/TOPIC`, `auto` or `auto:/TOPIC`, and the topic.

    Raises:
        SourceError: it does not exist; `option` is its name.
    """
    name, colon, topic = given.rpartition(":/")
    path_text, wanted = (name, f"/{topic}") if colon else (given, None)
    if path_text == AUTO:
        if recording is None:
            raise SourceError(f"`{option}=auto` needs a recording with {option}; give a file")
        path_text = recording
    path = Path(path_text)
    if not path.exists():
        raise SourceError(f"{path} does not exist; give `{option}` a file of {option}")
    return path, wanted


def log_of(path: Path) -> Log | None:
    """A file or folder as a log; None if it is none."""
    try:
        name = detect_format(path)
    except (SourceError, OSError):
        return None
    return open_container(path, name) if FORMATS[name].has_topics else None


def _of_video(path: Path) -> Positions:
    """Positions in a video (GPMF of GoPro, or CAMM), or else in a track of its name beside it."""
    found = read_motion_track(path)
    if found is not None and found.positions is not None:
        return _of_table(found.positions, f"{path} ({found.name})")
    beside = [path.with_suffix(suffix) for suffix in _TRACK_SUFFIXES]
    track = next((each for each in beside if each.is_file()), None)
    if track is None:
        names = ", ".join(each.name for each in beside)
        raise SourceError(f"{path} has no positions in it (GPMF, CAMM), or beside it ({names})")
    return _from_text(track)


def _from_text(path: Path) -> Positions:
    try:
        return _read_text(path)
    except SourceError as error:
        message = foreign_message(path)
        if message and "`positions" not in message:
            raise SourceError(message) from error
        raise


def _read_text(path: Path) -> Positions:
    if is_nmea(path):
        return _of_table(read_nmea(path), str(path))
    table = read_track(path) or read_position_csv(path)
    if table is not None:
        return _of_table(table, str(path))
    if not has_stamps(path):
        raise SourceError(f"{path} has poses without stamps; put its times.txt beside it")
    found = read_trajectory(path)
    unknown = np.full(len(found), np.nan)
    return Positions(str(path), "trajectory", found.stamps_ns, found.positions, unknown)


def _of_table(table: PositionTable, name: str) -> Positions:
    if not table.is_geodetic:
        return Positions(name, "positions", table.stamps_ns, table.values, table.sigma_m)
    origin = np.array(table.values[0])
    xyz = enu_from_geodetic(table.values, origin)
    return Positions(name, "gps", table.stamps_ns, xyz, table.sigma_m, origin, table.is_time_of_day)


def _from_log(log: Log, wanted: str | None) -> Positions:
    topic = _choose(log, wanted)
    name = f"{topic.name} of {log.path}"
    entries = log.entries([topic.name])[topic.name]
    if not issubclass(topic.codec.kind, PositionFixMessage):
        found = poses_on_topic(log, topic, entries).trajectory
        unknown = np.full(len(found), np.nan)
        source = "odometry" if topic.schema in _ODOMETRY else "trajectory"
        return Positions(name, source, found.stamps_ns, found.positions, unknown)
    stamps_ns, values, sigma_m = [], [], []
    for entry, stamp_ns in zip(entries, message_stamps(log, topic, entries), strict=True):
        try:
            message = topic.codec.decode(log.read(entry))
        except SourceError as error:
            _log.warning("%s: a message is left out: %s", name, error)
            continue
        if isinstance(message, PositionFixMessage) and np.isfinite(message.geodetic).all():
            stamps_ns.append(stamp_ns)
            values.append(message.geodetic)
            sigma_m.append(message.sigma_m)
    if not values:
        raise SourceError(f"{name} has no position with a fix; choose another topic")
    unique, rows = np.unique(np.array(stamps_ns, np.int64), return_index=True)
    table = PositionTable(unique, np.stack(values)[rows], np.array(sigma_m)[rows], True)
    return _of_table(table, name)


def _choose(log: Log, wanted: str | None) -> Topic:
    """The named topic, or the only one that can be meant: GPS before odometry before poses."""
    topics = [topic for topic in log.topics if issubclass(topic.codec.kind, _KINDS)]
    if wanted is not None:
        named = [topic for topic in topics if topic.name == wanted]
        if named:
            return named[0]
        raise SourceError(f"{log.path} has no positions on {wanted}; it has {_listed(topics)}")
    fixes = [topic for topic in topics if issubclass(topic.codec.kind, PositionFixMessage)]
    odometry = [topic for topic in topics if topic.schema in _ODOMETRY]
    for group in (fixes, odometry, topics):
        if len(group) == 1:
            return group[0]
        if group:
            raise SourceError(
                f"{log.path} has positions on {_listed(group)}; choose one: "
                f"`positions={log.path}:{group[0].name}`"
            )
    raise SourceError(f"{log.path} has no positions (NavSatFix, Odometry or poses); give a file")


def _listed(topics: Sequence[Topic]) -> str:
    return ", ".join(topic.name for topic in topics) or "none"
