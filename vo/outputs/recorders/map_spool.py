"""Keyframes and landmarks of a whole run, as models: those that have left the map are on disk."""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Camera, Floats, Ints, Landmarks, Sightings

LANDMARK_ROW = np.dtype(
    [("in_keyframe", "<f8", 3), ("keyframe", "<i4"), ("grey", "u1"), ("is_known", "?")]
)
"""A landmark: position in the cam0 frame of a keyframe that observes it, in units of odometry;
number of its frame."""

LandmarkRows = NDArray[Any]  # of LANDMARK_ROW

_OBSERVATION = np.dtype([("id", "<i8"), ("xy", "<f8", 2)])
_MAX_GAP = 4096  # rows that are read rather than skipped


class MapSpool:
    """Two files without names, which vanish with this object.

    `folder`: where the files are; None for the folder of temporary files.

    Raises:
        OSError: here and in every method: the files cannot be written or read.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._observations, self._landmarks = _unnamed_file(folder), _unnamed_file(folder)
        weakref.finalize(self, _close, self._observations, self._landmarks)
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


@dataclass(frozen=True, eq=False)
class MapSource:
    """Observations and landmarks on disk, and those of the present map."""

    spool: MapSpool  # what has left the map
    landmarks: Landmarks
    rows: LandmarkRows
    poses: tuple[Ints, Floats]  # frames (K,) of all keyframes, and their poses (K, 4, 4)
    scales: Floats  # (K,) lengths in the world of one unit of the rows of their landmarks
    scale: float = 1.0  # factor of all lengths that are given out

    def world_from_cam0(self, frames: Ints) -> Floats:
        """Poses (N, 4, 4) of keyframes."""
        poses = self.poses[1][np.searchsorted(self.poses[0], frames)]
        poses[..., :3, 3] *= self.scale
        return np.asarray(poses)

    def observations(self, frame: int) -> tuple[Ints, Floats]:
        """Ids (N,), increasing, and pixels (N, 2) of a keyframe."""
        in_map: Sightings | None = next(
            (each for each in self.landmarks.sightings if each.frame_index == frame), None
        )
        ids, xy = self.spool.observations(frame) if in_map is None else (in_map.ids, in_map.xy)
        order = np.argsort(ids, kind="stable")
        return ids[order], xy[order]

    def points(self, ids: Ints) -> tuple[Floats, Bytes]:
        """Points (N, 3) in the world, NaN where unknown, and grey levels (N,); increasing ids."""
        rows = self.spool.landmarks(ids)
        place = np.searchsorted(self.landmarks.ids, ids)
        place = np.minimum(place, max(len(self.landmarks.ids) - 1, 0))
        if len(self.landmarks.ids):
            in_map = self.landmarks.ids[place] == ids
            rows[in_map] = self.rows[place[in_map]]
        xyz = np.full((len(ids), 3), np.nan)
        known = rows["is_known"]
        frames = rows["keyframe"][known].astype(np.int64)
        scales = self.scale * self.scales[np.searchsorted(self.poses[0], frames)]
        in_keyframe = scales[:, None] * rows["in_keyframe"][known]
        xyz[known] = transformed(self.world_from_cam0(frames), in_keyframe)
        return xyz, rows["grey"].copy()


def transformed(a_from_b: Floats, points: Floats) -> Floats:
    """Points (N, 3), each moved by its own transform (N, 4, 4)."""
    rotated = np.einsum("nij,nj->ni", a_from_b[:, :3, :3], points)
    return np.asarray(rotated + a_from_b[:, :3, 3])


_MAX_ERROR_PX = 3.0  # observations with a larger reprojection error are left out
_MIN_OBSERVATIONS = 2
_TRACKS_AT_ONCE = 50_000  # observations that wait for the last one of their point


class ImageObservations(NamedTuple):
    """Observations of one keyframe."""

    keyframe: int  # row of the keyframe in its model
    point: Ints  # (N,) numbers of the points, from 0
    xy: Floats  # (N, 2) pixels in the keyframe's `View.image0`


class PointTracks(NamedTuple):
    """Points of a model with all their observations; M points, N observations."""

    number: Ints  # (M,) from 0, increasing
    xyz: Floats  # (M, 3) in the world
    grey: Bytes  # (M,) grey levels
    error_px: Floats  # (M,) mean distance between projection and observations
    first: Ints  # (M + 1,) where the observations of each point begin
    keyframe: Ints  # (N,) rows of the observing keyframes in the model, increasing for each point
    in_image: Ints  # (N,) rows in `ImageObservations` of that keyframe


class _Observations(NamedTuple):
    """Observations of several keyframes: arrays (N,) as in `PointTracks`."""

    point: Ints
    keyframe: Ints
    in_image: Ints

    def extended(self, image: ImageObservations) -> _Observations:
        count = len(image.point)
        return _Observations(
            np.concatenate([self.point, image.point]),
            np.concatenate([self.keyframe, np.full(count, image.keyframe)]),
            np.concatenate([self.in_image, np.arange(count)]),
        )

    def selected(self, rows: Ints) -> _Observations:
        return _Observations(self.point[rows], self.keyframe[rows], self.in_image[rows])


_NOTHING = _Observations(*(np.empty(0, np.int64) for _ in range(3)))


class Model:
    """Keyframes and points of one segment, read from disk keyframe by keyframe.

    `camera`: of `View.image0`. `frame_index`: (K,) numbers of the keyframes' frames.
    `world_from_image0`: (K, 4, 4) poses of the camera of `View.image0`. `point_count`: number of
    points.
    """

    def __init__(
        self, source: MapSource, camera: Camera, frame_index: Ints, cam0_from_image0: Floats
    ) -> None:
        self._source = source
        self.camera = camera
        self.frame_index = frame_index.astype(np.int64)
        self.world_from_image0 = source.world_from_cam0(self.frame_index) @ cam0_from_image0
        # By id of the landmark, from the first one on: observations, last keyframe, sum of errors.
        self._first_id = 0
        self._count = self._last = np.zeros(0, np.int32)
        self._error_sum = np.zeros(0)
        self._count_observations()
        is_point = self._count >= _MIN_OBSERVATIONS
        self._number = np.where(is_point, np.cumsum(is_point) - 1, -1)  # by id
        self._id = self._first_id + np.flatnonzero(is_point)  # by number
        self.point_count = len(self._id)

    def walk(self) -> Iterator[tuple[ImageObservations, PointTracks | None]]:
        """Each keyframe in time order, and now and then the points that no later one observes."""
        waiting = _NOTHING
        for row in range(len(self.frame_index)):
            ids, xy, _ = self._agreeing(row)
            number = self._number[ids - self._first_id]
            seen = ImageObservations(row, number[number >= 0], xy[number >= 0])
            waiting = waiting.extended(seen)
            done = None
            if row == len(self.frame_index) - 1 or len(waiting.point) > _TRACKS_AT_ONCE:
                is_done = self._last[self._id[waiting.point] - self._first_id] <= row
                done = self._tracks(waiting.selected(np.flatnonzero(is_done)))
                waiting = waiting.selected(np.flatnonzero(~is_done))
            yield seen, done

    def points(self) -> Iterator[PointTracks]:
        """All points, in parts."""
        return (points for _, points in self.walk() if points is not None)

    def _count_observations(self) -> None:
        """Count the observations that agree with their point, and sum their errors."""
        for row in range(len(self.frame_index)):
            ids, _, error_px = self._agreeing(row)
            if not len(ids):
                continue
            self._make_room(int(ids[0]), int(ids[-1]))
            rows = ids - self._first_id
            self._count[rows] += 1
            self._error_sum[rows] += error_px
            self._last[rows] = row

    def _make_room(self, first: int, last: int) -> None:
        """Extend the arrays by id."""
        if not len(self._count):
            self._first_id = first
        before = max(self._first_id - first, 0)
        after = max(last + 1 - self._first_id - len(self._count), 0)
        if before or after:
            after = max(after, len(self._count) // 4) if after else 0
            self._first_id -= before
            self._count = np.pad(self._count, (before, after))
            self._last = np.pad(self._last, (before, after))
            self._error_sum = np.pad(self._error_sum, (before, after))

    def _agreeing(self, row: int) -> tuple[Ints, Floats, Floats]:
        """Ids (N,), pixels (N, 2) and errors (N,) of a keyframe's observations that agree."""
        ids, xy = self._source.observations(int(self.frame_index[row]))
        xyz, _ = self._source.points(ids)
        image0_from_world = inverse(self.world_from_image0[row])
        local = xyz @ image0_from_world[:3, :3].T + image0_from_world[:3, 3]
        errors = np.linalg.norm(cameras.project(self.camera, local) - xy, axis=1)
        with np.errstate(invalid="ignore"):
            good = errors < _MAX_ERROR_PX
        return ids[good], xy[good], errors[good]

    def _tracks(self, observations: _Observations) -> PointTracks:
        ordered = observations.selected(np.argsort(observations.point, kind="stable"))
        number, first = np.unique(ordered.point, return_index=True)
        ids = self._id[number]
        xyz, grey = self._source.points(ids)
        rows = ids - self._first_id
        return PointTracks(
            number,
            xyz,
            grey,
            self._error_sum[rows] / self._count[rows],
            np.append(first, len(ordered.point)),
            ordered.keyframe,
            ordered.in_image,
        )
