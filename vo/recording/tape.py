"""What is to be recorded, collected for some frames and sent as columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from vo.recording.outlet import Outlet
from vo.recording.timelines import Moment, Timelines
from vo.types import Floats, Floats32

_Key = tuple[str, type[Any], tuple[str, ...]]


class Strips(NamedTuple):
    """Lines one after the other: their points (N, 2 or 3), and how many each has."""

    points: Floats32
    sizes: Sequence[int]

    @classmethod
    def alike(cls, lines: Floats | Floats32) -> Strips:
        """Lines (L, n, 2 or 3) of n points each."""
        return cls(
            lines.reshape(-1, lines.shape[2]).astype(np.float32), (lines.shape[1],) * len(lines)
        )


class Tape:
    """Rows of entities, sent to every outlet at once, because each chunk has a header of 1 kB.

    Args:
        outlets: where to send to.
        timelines: what turns moments into columns of time.
    """

    def __init__(self, outlets: Sequence[Outlet], timelines: Timelines) -> None:
        self._outlets = outlets
        self._timelines = timelines
        self._rows: dict[_Key, list[tuple[Moment, tuple[Any, ...]]]] = {}

    def fix(self, entity: str, archetype: Any) -> None:
        """Log what holds at all times; what was there before is replaced."""
        for outlet in self._outlets:
            outlet.fix(entity, archetype)

    def add(self, moment: Moment, entity: str, archetype: type[Any], **fields: Any) -> None:
        """Note a row of an archetype's fields: a sequence of instances each."""
        key = (entity, archetype, tuple(fields))
        self._rows.setdefault(key, []).append((moment, tuple(fields.values())))

    def send(self) -> None:
        """Hand all rows to the outlets."""
        rows, self._rows = self._rows, {}
        for (entity, archetype, names), noted in rows.items():
            times = self._timelines.columns([moment for moment, _ in noted])
            values = zip(*(row for _, row in noted), strict=True)
            columns = [
                column
                for name, value in zip(names, values, strict=True)
                for column in _column(archetype, name, value)
            ]
            for outlet in self._outlets:
                outlet.send(entity, times, columns)
        for outlet in self._outlets:
            outlet.flush()


def _column(archetype: type[Any], name: str, rows: tuple[Any, ...]) -> Any:
    if isinstance(rows[0], Strips):
        return [_strip_column(archetype, rows)]
    is_array = isinstance(rows[0], np.ndarray)
    joined = np.concatenate(rows) if is_array else [item for row in rows for item in row]
    column = archetype.columns(**{name: joined})
    return column.partition([len(row) for row in rows])


def _strip_column(archetype: type[Any], rows: tuple[Strips, ...]) -> rr.ComponentColumn:
    """Built by hand: rerun's own way takes 30 us a line."""
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
    """An array as rerun's columns take it."""

    def __init__(self, array: pa.Array) -> None:
        self._array = array

    def as_arrow_array(self) -> pa.Array:
        return self._array
