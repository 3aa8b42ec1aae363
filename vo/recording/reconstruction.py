"""Collects all keyframes and landmarks of a run, to be written at its end.

The local map holds the newest keyframes only. Of a keyframe or landmark that leaves it, the last
observations and positions are kept. If a keyframe gets a new pose later, the landmarks move with
the last keyframe that observes them.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.geometry import cameras
from vo.geometry.transforms import inverse
from vo.types import (
    Bools,
    Bytes,
    Camera,
    Estimate,
    Floats,
    Ints,
    KeyframePose,
    Landmarks,
    Sightings,
    Snapshot,
    Trajectory,
    View,
)

_MAX_ERROR_PX = 3.0  # observations with a larger reprojection error are left out
_MIN_OBSERVATIONS = 2
_MID_GREY = 128


@dataclass(frozen=True, eq=False)
class Model:
    """Keyframes and points of one segment; K keyframes, M points, N observations.

    Attributes:
        camera: of `View.image0`.
        frame_index: (K,) numbers of the keyframes' frames.
        world_from_image0: (K, 4, 4) poses of the camera of `View.image0`.
        xyz: (M, 3) in the world.
        grey: (M,) grey levels.
        error_px: (M,) mean distance between projection and observations.
        keyframe: (N,) row in frame_index of each observation, increasing.
        point: (N,) row in xyz of each observation.
        xy: (N, 2) pixels in the keyframe's `View.image0`.
    """

    camera: Camera
    frame_index: Ints
    world_from_image0: Floats
    xyz: Floats
    grey: Bytes
    error_px: Floats
    keyframe: Ints
    point: Ints
    xy: Floats


class Reconstruction:
    """All keyframes and landmarks that were in the map."""

    def __init__(self) -> None:
        self._keyframes: dict[int, KeyframePose] = {}
        self._last_in_map: dict[int, KeyframePose] = {}  # as the landmarks were last updated
        self._sightings: dict[int, Sightings] = {}
        self._xyz = np.full((1024, 3), np.nan)  # rows are ids
        self._grey = np.full(1024, _MID_GREY, dtype=np.uint8)
        self._camera: Camera | None = None
        self._cam0_from_image0 = np.eye(4)

    def add(self, estimate: Estimate, snapshot: Snapshot) -> None:
        """Add a frame."""
        self._camera = camera_of(snapshot.view)
        if snapshot.view.cam0_from_image0 is not None:
            self._cam0_from_image0 = snapshot.view.cam0_from_image0
        for keyframe in estimate.keyframes:
            self._keyframes[keyframe.frame_index] = keyframe
        if snapshot.landmarks is not None:
            self._add_landmarks(snapshot.landmarks)

    def _add_landmarks(self, landmarks: Landmarks) -> None:
        for sightings in landmarks.sightings:
            frame = sightings.frame_index
            self._sightings[frame] = sightings
            if frame in self._keyframes:
                self._last_in_map[frame] = self._keyframes[frame]
        if not len(landmarks.ids):
            return
        missing = int(landmarks.ids[-1]) + 1 - len(self._xyz)
        if missing > 0:
            missing = max(missing, len(self._xyz))
            self._xyz = np.concatenate([self._xyz, np.full((missing, 3), np.nan)])
            grey = np.full(missing, _MID_GREY, dtype=np.uint8)
            self._grey = np.concatenate([self._grey, grey])
        self._xyz[landmarks.ids] = landmarks.xyz
        if landmarks.grey is not None:
            self._grey[landmarks.ids] = landmarks.grey

    def models(self, smoothed: Trajectory, frames: Container[int] | None = None) -> list[Model]:
        """A model for each segment, the one with most keyframes first.

        Args:
            smoothed: the final path; points move with the last keyframe that observes them.
            frames: if given, only keyframes of these frames are used.
        """
        if self._camera is None:
            return []
        known = sorted(self._last_in_map)
        known = [k for k in known if frames is None or k in frames]
        segments = [self._keyframes[k].segment for k in known]
        models = [
            self._model([k for k, s in zip(known, segments, strict=True) if s == segment], smoothed)
            for segment in sorted(set(segments))
        ]
        return sorted(models, key=lambda model: -len(model.frame_index))

    def _model(self, frames: list[int], smoothed: Trajectory) -> Model:
        assert self._camera is not None
        observations = _all_observations([self._sightings[frame] for frame in frames])
        before = np.stack([self._last_in_map[frame].world_from_cam0 for frame in frames])
        newest = np.stack([self._keyframes[frame].world_from_cam0 for frame in frames])
        stamps_ns = np.array([self._keyframes[frame].stamp_ns for frame in frames])
        after = _poses_at(stamps_ns, smoothed, newest)
        points = self._moved_points(observations, after @ inverse(before))
        world_from_image0 = after @ self._cam0_from_image0
        errors = _errors(self._camera, points, world_from_image0, observations)
        good = _agreeing(observations, errors)
        ids, first, point = np.unique(
            observations.ids[good], return_index=True, return_inverse=True
        )
        sums = np.bincount(point, weights=errors[good], minlength=len(ids))
        return Model(
            camera=self._camera,
            frame_index=np.array(frames, dtype=np.int64),
            world_from_image0=world_from_image0,
            xyz=points[good][first],
            grey=self._grey[ids],
            error_px=sums / np.bincount(point, minlength=len(ids)),
            keyframe=observations.keyframe[good],
            point=point.astype(np.int64),
            xy=observations.xy[good],
        )

    def _moved_points(self, observations: _Observations, moves: Floats) -> Floats:
        """The point (N, 3) of each observation, moved with the last keyframe that observes it."""
        ids = observations.ids
        last_keyframe = np.full(len(self._xyz), -1)
        last_keyframe[ids] = observations.keyframe  # rows are in time order: the last one remains
        move = moves[last_keyframe[ids]]
        rotated = np.einsum("nij,nj->ni", move[:, :3, :3], self._xyz[ids])
        return np.asarray(rotated + move[:, :3, 3])


class _Observations(NamedTuple):
    """Observations: ids (N,) of landmarks, row (N,) of the keyframe, pixels (N, 2)."""

    ids: Ints
    keyframe: Ints
    xy: Floats


def _all_observations(sightings: Sequence[Sightings]) -> _Observations:
    counts = [len(each.ids) for each in sightings]
    return _Observations(
        np.concatenate([each.ids for each in sightings]),
        np.repeat(np.arange(len(sightings)), counts),
        np.concatenate([each.xy for each in sightings]),
    )


def _agreeing(observations: _Observations, errors: Floats) -> Bools:
    """Observations (N,) with a small error whose point has enough of them."""
    good = errors < _MAX_ERROR_PX
    count = np.bincount(observations.ids[good], minlength=int(observations.ids.max(initial=0)) + 1)
    return np.asarray(good & (count[observations.ids] >= _MIN_OBSERVATIONS))


def _errors(
    camera: Camera, points: Floats, world_from_image0: Floats, observations: _Observations
) -> Floats:
    """Distances (N,) between projection and observation; infinite without a projection."""
    image0_from_world = inverse(world_from_image0)[observations.keyframe]
    local = np.einsum("nij,nj->ni", image0_from_world[:, :3, :3], points)
    projected = cameras.project(camera, local + image0_from_world[:, :3, 3])
    errors = np.linalg.norm(projected - observations.xy, axis=1)
    return np.where(np.isfinite(errors), errors, np.inf)


def _poses_at(stamps_ns: Ints, path: Trajectory, otherwise: Floats) -> Floats:
    """Poses (K, 4, 4) of the path at stamps (K,); `otherwise` at other stamps."""
    if not len(path):
        return otherwise
    rows = np.minimum(np.searchsorted(path.stamps_ns, stamps_ns), len(path) - 1)
    exists = path.stamps_ns[rows] == stamps_ns
    return np.where(exists[:, None, None], path.world_from_cam[rows], otherwise)


def camera_of(view: View) -> Camera:
    """The camera of `view.image0`, with its distortion if the image is as recorded."""
    return view.lens if view.lens is not None else pinhole_of(view)


def pinhole_of(view: View) -> Camera:
    """The ideal pinhole camera of `view`."""
    height, width = view.image0.shape
    k = view.camera_matrix
    return Camera(width, height, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
