"""The map view: camera, paths, keyframes and landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats, Landmarks, State, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.keyframe_history import (
    CausalPath,
    KeyframeChanges,
    KeyframeGraph,
    KeyframeHistory,
    SmoothedPath,
)
from vo.outputs.recorders.settled_layer import LandmarkHistory, SettledLayer, add_points, add_strips
from vo.outputs.recorders.timelines import Batch, Moment

_PATHS = {
    entities.CAUSAL_PATH: (entities.ORANGE, 1.2),
    entities.WINDOW_PATH: (entities.PINK, 2.5),
    entities.TRUE_PATH: (entities.GREEN, 1.2),
    entities.GRAPH: ((110, 110, 125), 0.5),
}
_FRUSTUM_PER_DEPTH = 0.1  # size of the camera relative to the median distance of landmarks,
_FRUSTUM_PER_PATH = 0.04  # or to its distance from the start, if that is more
_FRUSTUM_STEP = 1.25
_FRAMES_BETWEEN_MAPS = 10  # the local map takes the most space after the images
_EDGES_PER_KEYFRAME = 4


class MapLayer:
    """Logs the camera, the paths, the keyframes and the landmarks of each frame.

    Keyframes may be re-posed at any time, as after a loop closure: the settled path and landmarks
    of `SettledLayer` follow.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._causal = CausalPath()
        self._smoothed = SmoothedPath()
        self._graph = KeyframeGraph()
        self._keyframes = KeyframeHistory()
        self._landmarks = LandmarkHistory()
        self._settled = SettledLayer(batch, self._keyframes.poses)
        self._next_map_frame = 0
        self._frustum = 0.0
        self._state: State | None = None

    def log_styles(self) -> None:
        """Log the axes, and the colours and sizes that never change."""
        self._batch.log_static(entities.WORLD, rr.ViewCoordinates.RDF)
        for entity, (colour, radius) in _PATHS.items():
            style = rr.LineStrips3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(radius))
            self._batch.log_static(entity, style)
        self._settled.log_styles()

    def add(self, moment: Moment, estimate: Estimate, snapshot: Snapshot) -> None:
        """Add what changes in the map with a frame."""
        self._add_state(moment, estimate.state)
        pose, landmarks = estimate.world_from_cam0, snapshot.landmarks
        if pose is not None:
            self._add_pose(moment, pose, estimate.segment)
        elif estimate.predicted is not None:
            self._add_camera(moment, estimate.predicted.world_from_cam0)
        is_reposed = False
        if estimate.keyframes:
            changes = self._keyframes.update(estimate.keyframes, snapshot)
            is_reposed = bool(changes.moves)
            self._graph.add(estimate.frame_index, _closest(snapshot.neighbours))
            self._add_keyframes(moment, changes)
        is_map_due = estimate.frame_index >= self._next_map_frame or is_reposed
        if landmarks is not None and pose is not None and is_map_due:
            self._next_map_frame = estimate.frame_index + _FRAMES_BETWEEN_MAPS
            self._add_landmarks(moment, landmarks, pose)
        self._settled.log_changed_chunks(moment)

    def finish(self, moment: Moment, pieces: Sequence[Trajectory]) -> None:
        """Log the final path, one strip per segment, instead of the growing one."""
        self._settled.finish(moment, self._keyframes.window, pieces)
        self._batch.log_static(entities.WINDOW_PATH, rr.LineStrips3D.from_fields(strips=[]))

    def log_ground_truth(self, positions: Floats) -> None:
        """Log the true path (N, 3) instead of an earlier one."""
        path = rr.LineStrips3D.from_fields(strips=[positions])
        self._batch.log_static(entities.TRUE_PATH, path)

    def _add_camera(self, moment: Moment, pose: Floats) -> None:
        self._batch.add(
            moment,
            entities.CAM0,
            rr.Transform3D,
            translation=pose[None, :3, 3],
            quaternion=quat_xyzw_from_rotation(pose[:3, :3])[None],
        )

    def _add_pose(self, moment: Moment, pose: Floats, segment: int) -> None:
        self._add_camera(moment, pose)
        line = self._causal.extend(pose[:3, 3], segment)
        if line is not None:
            add_strips(self._batch, moment, entities.CAUSAL_PATH, [line])
        self._grow_frustum(moment, _FRUSTUM_PER_PATH * float(np.linalg.norm(pose[:3, 3])))

    def _add_keyframes(self, moment: Moment, changes: KeyframeChanges) -> None:
        poses = self._keyframes.poses
        if changes.moves:
            self._landmarks.move(changes.moves)
            self._settled.repose(changes.moves)
        lines = self._smoothed.update(changes, poses)
        self._settled.add_keyframes(moment, changes.settled, lines)
        strips = self._smoothed.strips(self._keyframes.window)
        add_strips(self._batch, moment, entities.WINDOW_PATH, strips)
        edges = self._graph.lines(changes.optimised, poses)
        add_strips(self._batch, moment, entities.GRAPH, list(edges))

    def _add_landmarks(self, moment: Moment, landmarks: Landmarks, pose: Floats) -> None:
        local, settled = self._landmarks.update(landmarks, pose)
        add_points(self._batch, moment, entities.LOCAL_LANDMARKS, local)
        self._settled.add_landmarks(moment, settled)
        if len(landmarks.xyz):
            distances = np.linalg.norm(landmarks.xyz - pose[:3, 3], axis=1)
            self._grow_frustum(moment, _FRUSTUM_PER_DEPTH * median(distances))

    def _grow_frustum(self, moment: Moment, size: float) -> None:
        """Keep the camera visible as the path grows; in steps, not in every frame."""
        if size > _FRUSTUM_STEP * self._frustum:
            self._frustum = size
            self._batch.add(moment, entities.LEFT, rr.Pinhole, image_plane_distance=[size])

    def _add_state(self, moment: Moment, state: State) -> None:
        """Draw the camera in red while it is lost."""
        if state != self._state:
            self._state = state
            colour = entities.VERMILION if state == State.LOST else entities.GREEN
            self._batch.add(moment, entities.LEFT, rr.Pinhole, color=[colour])


def _closest(neighbours: Mapping[int, int]) -> tuple[int, ...]:
    """Frame numbers of the keyframes that share the most landmarks."""
    return tuple(sorted(neighbours, key=lambda frame: -neighbours[frame])[:_EDGES_PER_KEYFRAME])
