"""Collects all keyframes and landmarks of a run, to be written during the run and at its end.

The local map holds the newest keyframes only. Of a keyframe or landmark that leaves it, the last
observations and positions are kept on disk. If a keyframe gets a new pose or scale later, the
landmarks move with the last keyframe that observed them.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.records.metric_scale import MetricScale
from vo.base.records.snapshot import Snapshot, View
from vo.base.types import Bytes, Camera, Estimate, Floats, Ints, KeyframePose, Landmarks, Trajectory
from vo.outputs.recorders.map_spool import (
    LANDMARK_ROW,
    LandmarkRows,
    MapSource,
    MapSpool,
    Model,
    transformed,
)
from vo.outputs.recorders.recorder import LoopClosures

_MID_GREY = 128
_BRIGHTNESS = 0.35  # of hidden pixels

_NO_MAP = Landmarks(np.empty(0, np.int64), np.empty((0, 3)))


class Reconstruction:
    """All keyframes and landmarks that were in the map; one for all exports of a run.

    Raises:
        OSError: in every method: the temporary files cannot be written or read.
    """

    def __init__(self) -> None:
        self._spool: MapSpool | None = None
        self._newest = -1  # number of the last frame that was added
        self._keyframes: dict[int, KeyframePose] = {}
        self._known: set[int] = set()  # frames of keyframes with observations and a pose
        self._map = _NO_MAP
        self._in_map: dict[int, KeyframePose] = {}  # as the landmarks of `_map` were updated
        self._camera: Camera | None = None
        self._cam0_from_image0 = np.eye(4)

    def open(self, folder: Path | None) -> None:
        """Create the temporary files, unless another export has; None for the system's folder."""
        self._spool = self._spool or MapSpool(folder)

    def add(self, estimate: Estimate, snapshot: Snapshot) -> None:
        """Add a frame, unless another export has done so."""
        if estimate.frame_index == self._newest:
            return
        self.open(None)
        self._camera = camera_of(snapshot.view)
        if snapshot.view.cam0_from_image0 is not None:
            self._cam0_from_image0 = snapshot.view.cam0_from_image0
        for keyframe in estimate.keyframes:
            self._keyframes[keyframe.frame_index] = replace(keyframe, covariance=None)
        if snapshot.landmarks is not None:
            self._replace_map(snapshot.landmarks)
        self._newest = estimate.frame_index

    def models(
        self,
        smoothed: Trajectory | None = None,
        frames: Container[int] | None = None,
        scales: Mapping[int, MetricScale] = MappingProxyType({}),
        closures: LoopClosures | None = None,
    ) -> list[Model]:
        """A model for each world, the one with most keyframes first.

        `smoothed`: the final path; points move with the last keyframe that observes them. `frames`:
        if given, only keyframes of these frames are used. `scales`: by segment, to convert the
        model to metres. `closures`: loops that connected segments; without any, each segment is a
        world.
        """
        if self._camera is None or self._spool is None:
            return []
        rows, poses = self._map_rows(), self._poses(smoothed)
        kept = {k: self._keyframes[k].scale for k in sorted(self._known)}
        if closures is not None:
            kept = {k: closures.scales.get(k, scale) for k, scale in kept.items()}
        map_scales = np.array(list(kept.values()))
        models = []
        for segment, chosen in self._by_world(frames, closures):
            metric = _value(scales.get(segment))
            source = MapSource(self._spool, self._map, rows, poses, map_scales, metric)
            models.append(Model(source, self._camera, np.array(chosen), self._cam0_from_image0))
        return sorted(models, key=lambda model: -len(model.frame_index))

    def _by_world(
        self, frames: Container[int] | None, closures: LoopClosures | None
    ) -> list[tuple[int, list[int]]]:
        """First segment of each world, and the frames of its keyframes."""
        worlds = {} if closures is None else closures.worlds
        found: dict[int, list[int]] = {}
        for frame in sorted(self._known):
            if frames is None or frame in frames:
                segment = self._keyframes[frame].segment
                found.setdefault(worlds.get(segment, segment), []).append(frame)
        return [(self._keyframes[each[0]].segment, each) for _, each in sorted(found.items())]

    def _replace_map(self, landmarks: Landmarks) -> None:
        """Store what has left the map."""
        assert self._spool is not None
        frames = {each.frame_index for each in landmarks.sightings}
        for sightings in self._map.sightings:
            if sightings.frame_index not in frames:
                self._spool.add_keyframe(sightings)
        has_left = ~np.isin(self._map.ids, landmarks.ids, assume_unique=True)
        if has_left.any():
            self._spool.add_landmarks(self._map.ids[has_left], self._map_rows()[has_left])
        self._map = landmarks
        self._in_map = {k: self._keyframes[k] for k in frames if k in self._keyframes}
        self._known |= self._in_map.keys()

    def _map_rows(self) -> LandmarkRows:
        """The landmarks of the map, each relative to the last keyframe that observes it."""
        landmarks = self._map
        rows = np.zeros(len(landmarks.ids), LANDMARK_ROW)
        frames = sorted(self._in_map)
        if not frames or not len(rows):
            return rows
        last = np.full(len(rows), len(frames) - 1)  # of those without an observation in the map
        for sightings in landmarks.sightings:  # in time order
            if sightings.frame_index in self._in_map:
                seen = np.searchsorted(landmarks.ids, sightings.ids)
                seen = seen[seen < len(rows)]
                last[seen] = frames.index(sightings.frame_index)
        poses = np.stack([self._in_map[frame].world_from_cam0 for frame in frames])
        cam0_from_world = inverse(poses)[last]
        # All landmarks have the scale of the newest keyframe (`make_snapshot`).
        in_keyframe = transformed(cam0_from_world, landmarks.xyz)
        rows["in_keyframe"] = in_keyframe / self._in_map[frames[-1]].scale
        rows["keyframe"] = np.array(frames)[last]
        rows["grey"] = _MID_GREY if landmarks.grey is None else landmarks.grey
        rows["is_known"] = True
        return rows

    def _poses(self, smoothed: Trajectory | None) -> tuple[Ints, Floats]:
        """Frames (K,) of all known keyframes, and their final poses (K, 4, 4)."""
        frames = sorted(self._known)
        newest = [self._keyframes[frame].world_from_cam0 for frame in frames]
        poses = np.stack(newest) if newest else np.empty((0, 4, 4))
        if smoothed is not None and len(smoothed) and frames:
            stamps_ns = np.array([self._keyframes[frame].stamp_ns for frame in frames])
            rows = np.minimum(np.searchsorted(smoothed.stamps_ns, stamps_ns), len(smoothed) - 1)
            exists = smoothed.stamps_ns[rows] == stamps_ns
            poses = np.where(exists[:, None, None], smoothed.world_from_cam[rows], poses)
        return np.array(frames, dtype=np.int64), poses


def _value(scale: MetricScale | None) -> float:
    return 1.0 if scale is None else scale.value


def camera_of(view: View) -> Camera:
    """The camera of `view.image0`, with its distortion if the image is as recorded."""
    return view.lens if view.lens is not None else pinhole_of(view)


def pinhole_of(view: View) -> Camera:
    """The ideal pinhole camera of `view`."""
    height, width = view.image0.shape
    k = view.camera_matrix
    return Camera(width, height, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))


def dimmed(image: Bytes, mask: Bytes | None) -> Bytes:
    """An image (H, W) that is darker where a mask (H, W) is 0."""
    if mask is None:
        return image
    dark = cv2.convertScaleAbs(image, alpha=_BRIGHTNESS)
    return np.asarray(np.where(mask > 0, image, dark))
