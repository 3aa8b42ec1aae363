"""Timelines, moments and segments of the recorded frames, and complete trajectories as rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Estimate, Floats, Floats32, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.sink import Sink

_EARLIEST_EPOCH_NS = 10**17  # March 1973: smaller stamps are not relative to the Unix epoch


class Moment(NamedTuple):
    """Number and time of a frame."""

    frame_index: int
    stamp_ns: int


class Timelines:
    """Converts moments to columns; the first one decides whether stamps are Unix times."""

    def __init__(self) -> None:
        self._is_unix_time: bool | None = None

    def columns(self, moments: Sequence[Moment]) -> list[rr.TimeColumn]:
        """Columns of both timelines for rows at these moments."""
        frames = np.array([moment.frame_index for moment in moments], dtype=np.int64)
        stamps = np.array([moment.stamp_ns for moment in moments], dtype=np.int64)
        if self._is_unix_time is None:
            self._is_unix_time = bool(stamps[0] >= _EARLIEST_EPOCH_NS)
        name = entities.SENSOR_TIMELINE
        if self._is_unix_time:
            sensor = rr.TimeColumn(name, timestamp=stamps.astype("datetime64[ns]"))
        else:
            sensor = rr.TimeColumn(name, duration=stamps.astype("timedelta64[ns]"))
        return [rr.TimeColumn(entities.FRAME_TIMELINE, sequence=frames), sensor]


_POSE_NAMES = ["tx", "ty", "tz", "qx", "qy", "qz", "qw"]


class RunIndex:
    """The frames recorded so far: their moments, and the ends of segments."""

    def __init__(self) -> None:
        self._moments: dict[int, Moment] = {}
        self._last_stamp: dict[int, int] = {}  # of the causal poses of each segment

    def __len__(self) -> int:
        return len(self._moments)

    def add(self, estimate: Estimate) -> Moment:
        """Add a frame; its moment."""
        moment = Moment(estimate.frame_index, estimate.stamp_ns)
        self._moments[estimate.stamp_ns] = moment
        if estimate.world_from_cam0 is not None:
            self._last_stamp[estimate.segment] = estimate.stamp_ns
        return moment

    @property
    def first(self) -> Moment:
        """The oldest frame."""
        return self._moments[next(iter(self._moments))]

    @property
    def last(self) -> Moment:
        """The newest frame."""
        return self._moments[next(reversed(self._moments))]

    @property
    def by_frame(self) -> dict[int, Moment]:
        """The moments by number of their frame."""
        return {moment.frame_index: moment for moment in self._moments.values()}

    def moment(self, stamp_ns: int) -> Moment | None:
        """The moment of the frame with this stamp, None if it was not recorded."""
        return self._moments.get(stamp_ns)

    def by_segment(self, trajectory: Trajectory) -> list[Trajectory]:
        """A trajectory divided at the ends of segments; empty pieces are left out.

        Not at their beginnings: frames before the first mono map may get a pose in it later.
        """
        return [piece for _, piece in self._pieces(trajectory)]

    def by_world(self, trajectory: Trajectory, worlds: Mapping[int, int]) -> list[Trajectory]:
        """A trajectory as `by_segment`, with the segments of each world together.

        `worlds`: number of the world of each segment that was connected to another one.
        """
        found: dict[int, list[Trajectory]] = {}
        for segment, piece in self._pieces(trajectory):
            found.setdefault(worlds.get(segment, segment), []).append(piece)
        return [
            Trajectory(
                np.concatenate([piece.stamps_ns for piece in pieces]),
                np.concatenate([piece.world_from_cam for piece in pieces]),
            )
            for pieces in found.values()
        ]

    def _pieces(self, trajectory: Trajectory) -> list[tuple[int, Trajectory]]:
        """Segments that are not empty, with their numbers."""
        ends = list(self._last_stamp.values())[:-1]
        cuts = np.searchsorted(trajectory.stamps_ns, ends, side="right")
        stamps = np.split(trajectory.stamps_ns, cuts)
        poses = np.split(trajectory.world_from_cam, cuts)
        rows = zip(list(self._last_stamp) or [0], stamps, poses, strict=True)
        return [(segment, Trajectory(stamp, pose)) for segment, stamp, pose in rows if len(stamp)]


def add_trajectory(batch: Batch, entity: str, trajectory: Trajectory, index: RunIndex) -> None:
    """Add poses as rows of seven float64 (tx ty tz qx qy qz qw); transforms are only float32."""
    batch.log_static(entity, rr.SeriesLines(names=_POSE_NAMES))
    for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), _pose_rows(trajectory), strict=True):
        moment = index.moment(stamp_ns)
        if moment is not None:
            batch.add(moment, entity, rr.Scalars, scalars=row)


def _pose_rows(trajectory: Trajectory) -> Floats:
    quats = [quat_xyzw_from_rotation(pose[:3, :3]) for pose in trajectory.world_from_cam]
    return np.concatenate([trajectory.positions, np.array(quats).reshape(-1, 4)], axis=1)


_Key = tuple[str, type[Any], tuple[str, ...]]


class Strips(NamedTuple):
    """Lines one after another: their points (N, 2 or 3) and the number of points of each."""

    points: Floats32
    sizes: Sequence[int]

    @classmethod
    def of_equal_size(cls, lines: Floats | Floats32) -> Strips:
        """Lines (L, n, 2 or 3) of n points each."""
        return cls(
            lines.reshape(-1, lines.shape[2]).astype(np.float32), (lines.shape[1],) * len(lines)
        )


class Batch:
    """Rows by entity, sent to every sink together, because each chunk has a header of 1 kB.

    `timelines`: converts moments to time columns.
    """

    def __init__(self, sinks: Sequence[Sink], timelines: Timelines) -> None:
        self._sinks = sinks
        self._timelines = timelines
        self._rows: dict[_Key, list[tuple[Moment, tuple[Any, ...]]]] = {}

    def log_static(self, entity: str, archetype: Any) -> None:
        """Log data that are valid at all times, instead of earlier ones."""
        for sink in self._sinks:
            sink.log_static(entity, archetype)

    def add(self, moment: Moment, entity: str, archetype: type[Any], **fields: Any) -> None:
        """Add a row of an archetype's fields, each a sequence of instances."""
        key = (entity, archetype, tuple(fields))
        self._rows.setdefault(key, []).append((moment, tuple(fields.values())))

    def send(self) -> None:
        """Send all rows to the sinks."""
        rows, self._rows = self._rows, {}
        for (entity, archetype, names), added in rows.items():
            times = self._timelines.columns([moment for moment, _ in added])
            values = zip(*(row for _, row in added), strict=True)
            columns = [
                column
                for name, value in zip(names, values, strict=True)
                for column in _column(archetype, name, value)
            ]
            for sink in self._sinks:
                sink.send(entity, times, columns)
        for sink in self._sinks:
            sink.flush()


def _column(archetype: type[Any], name: str, rows: tuple[Any, ...]) -> Any:
    if isinstance(rows[0], Strips):
        return [_strip_column(archetype, rows)]
    is_array = isinstance(rows[0], np.ndarray)
    joined = np.concatenate(rows) if is_array else [item for row in rows for item in row]
    column = archetype.columns(**{name: joined})
    return column.partition([len(row) for row in rows])


def _strip_column(archetype: type[Any], rows: tuple[Strips, ...]) -> rr.ComponentColumn:
    """Build the column directly: rerun's own conversion takes 30 us per line."""
    points = np.concatenate([row.points for row in rows])
    sizes = [size for row in rows for size in row.sizes]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    point = pa.list_(pa.field("item", pa.float32(), nullable=False), points.shape[1])
    inner = pa.FixedSizeListArray.from_arrays(pa.array(points.ravel()), type=point)
    strip = pa.list_(pa.field("item", point, nullable=False))
    strips = _Arrow(pa.ListArray.from_arrays(pa.array(offsets), inner, type=strip))
    descriptor = archetype.descriptor_strips()
    return rr.ComponentColumn(descriptor, strips, lengths=[len(row.sizes) for row in rows])


class _Arrow:
    """Adapter of an array for rerun's columns."""

    def __init__(self, array: pa.Array) -> None:
        self._array = array

    def as_arrow_array(self) -> pa.Array:
        return self._array
