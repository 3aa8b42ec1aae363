"""Keyframes and points of one segment of a run, in parts, so that memory does not grow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Camera, Floats, Ints
from vo.outputs.recorders.map_source import MapSource

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
