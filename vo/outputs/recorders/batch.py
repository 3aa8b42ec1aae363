"""Rows to record, collected over several frames and sent as columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from vo.base.types import Floats, Floats32
from vo.outputs.recorders.sink import Sink
from vo.outputs.recorders.timelines import Moment, Timelines

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
