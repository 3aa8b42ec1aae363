"""Keyframes and landmarks that have left the map, on disk, so that memory does not grow."""

from __future__ import annotations

import os
import tempfile
import weakref
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Floats, Ints, Sightings

LANDMARK_ROW = np.dtype(
    [("in_keyframe", "<f8", 3), ("keyframe", "<i4"), ("grey", "u1"), ("is_known", "?")]
)
"""A landmark: position in the cam0 frame of a keyframe that observes it, in units of odometry;
number of its frame."""

LandmarkRows = NDArray[Any]  # of LANDMARK_ROW

_OBSERVATION = np.dtype([("id", "<i8"), ("xy", "<f8", 2)])
_MAX_GAP = 4096  # rows that are read rather than skipped


class MapSpool:
    """Two files without names, which vanish with the process.

    `folder`: where the files are; None for the folder of temporary files.

    Raises:
        OSError: here and in every method: the files cannot be written or read.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._observations, self._landmarks = _unnamed_file(folder), _unnamed_file(folder)
        self._close = weakref.finalize(self, _close, self._observations, self._landmarks)
        self._blocks: dict[int, tuple[int, int]] = {}  # position and rows, by frame number
        self._end = 0

    def add_keyframe(self, sightings: Sightings) -> None:
        """Store the observations of a keyframe, instead of earlier ones."""
        rows = np.empty(len(sightings.ids), _OBSERVATION)
        rows["id"], rows["xy"] = sightings.ids, sightings.xy
        self._blocks[sightings.frame_index] = (self._end, len(rows))
        _write(self._observations, rows.tobytes(), self._end)
        self._end += rows.nbytes

    def add_landmarks(self, ids: Ints, rows: LandmarkRows) -> None:
        """Store landmarks (N,) by id, instead of earlier rows; ids are increasing."""
        size = LANDMARK_ROW.itemsize
        for part in _runs(ids, max_gap=1):
            _write(self._landmarks, rows[part].tobytes(), int(ids[part][0]) * size)

    def observations(self, frame: int) -> tuple[Ints, Floats]:
        """Ids (N,) and pixels (N, 2) of a keyframe, which must have been stored."""
        position, count = self._blocks[frame]
        data = os.pread(self._observations, count * _OBSERVATION.itemsize, position)
        rows = np.frombuffer(data, _OBSERVATION)
        return rows["id"].copy(), rows["xy"].copy()

    def landmarks(self, ids: Ints) -> LandmarkRows:
        """Rows (N,) of landmarks, not `is_known` where none was stored; ids are increasing."""
        size = LANDMARK_ROW.itemsize
        rows = np.zeros(len(ids), LANDMARK_ROW)
        for part in _runs(ids, max_gap=_MAX_GAP):
            wanted = ids[part] - ids[part][0]
            data = os.pread(self._landmarks, int(wanted[-1] + 1) * size, int(ids[part][0]) * size)
            stored = np.frombuffer(data[: len(data) // size * size], LANDMARK_ROW)
            exists = wanted < len(stored)  # the file may be shorter
            rows[part][exists] = stored[wanted[exists]]
        return rows

    def close(self) -> None:
        """Remove the files."""
        self._close()


def _unnamed_file(folder: Path | None) -> int:
    with tempfile.TemporaryFile(dir=folder) as file:
        return os.dup(file.fileno())


def _close(*files: int) -> None:
    for file in files:
        os.close(file)


def _runs(ids: Ints, max_gap: int) -> list[slice]:
    """Slices of increasing ids that are at most `max_gap` apart."""
    if not len(ids):
        return []
    breaks = np.flatnonzero(np.diff(ids) > max_gap) + 1
    bounds = [0, *breaks.tolist(), len(ids)]
    return [slice(a, b) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def _write(file: int, data: bytes, position: int) -> None:
    rest = memoryview(data)
    while rest:
        written = os.pwrite(file, rest, position)
        rest, position = rest[written:], position + written
