"""The world: camera, paths, keyframes and landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from vo.geometry.quantiles import median
from vo.geometry.transforms import quat_xyzw_from_rotation
from vo.recording import entities
from vo.recording.scene import GrowingMap, GrowingPath, KeyframeGraph, Points, SmoothedPath
from vo.recording.tape import Strips, Tape
from vo.recording.timelines import Moment
from vo.types import Estimate, Floats, KeyframePose, Landmarks, Snapshot, State, Trajectory

_PATHS = {
    entities.CAUSAL_PATH: (entities.ORANGE, 1.2),
    entities.SMOOTHED_PATH: (entities.SKY, 2.0),
    entities.WINDOW_PATH: (entities.PINK, 2.5),
    entities.TRUE_PATH: (entities.GREEN, 1.2),
    entities.GRAPH: ((110, 110, 125), 0.5),
}
_FRUSTUM_SHARE_OF_DEPTH = 0.1
_FRUSTUM_SHARE_OF_PATH = 0.04
_FRUSTUM_STEP = 1.25
_FRAMES_BETWEEN_MAPS = 10  # the local map is the largest thing after the images
_EDGES_PER_KEYFRAME = 4
_SHOWN_SIGMAS = 10.0  # one would be too small to be seen


class MapLayer:
    """Logs the camera, the paths, the keyframes and the landmarks of each frame."""

    def __init__(self, tape: Tape) -> None:
        self._tape = tape
        self._causal = GrowingPath()
        self._smoothed = SmoothedPath()
        self._graph = KeyframeGraph()
        self._landmarks = GrowingMap()
        self._next_map_frame = 0
        self._frustum = 0.0
        self._state: State | None = None

    def fix_styles(self) -> None:
        """Log the axes, and the colours and sizes that never change."""
        self._tape.fix(entities.WORLD, rr.ViewCoordinates.RDF)
        for entity, (colour, radius) in _PATHS.items():
            style = rr.LineStrips3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(radius))
            self._tape.fix(entity, style)
        shells = rr.Ellipsoids3D.from_fields(
            colors=[entities.PINK], line_radii=rr.Radius.ui_points(0.4)
        )
        self._tape.fix(entities.COVARIANCE, shells)

    def add(self, moment: Moment, estimate: Estimate, snapshot: Snapshot) -> None:
        """Note what a frame adds to the world."""
        self._add_state(moment, estimate.state)
        pose = estimate.world_from_cam0
        if pose is not None:
            self._add_pose(moment, pose, estimate.segment)
        if estimate.keyframes:
            self._add_keyframes(moment, estimate, snapshot.neighbours)
        is_map_due = estimate.frame_index >= self._next_map_frame
        if snapshot.landmarks is not None and pose is not None and is_map_due:
            self._next_map_frame = estimate.frame_index + _FRAMES_BETWEEN_MAPS
            self._add_landmarks(moment, snapshot.landmarks, pose)

    def finish(self, moment: Moment, pieces: Sequence[Trajectory]) -> None:
        """Log the final path, a strip for each segment, in place of the growing one."""
        self._add_covariances(moment, self._smoothed.window)
        strips = [piece.positions for piece in pieces]
        self._tape.fix(entities.SMOOTHED_PATH, rr.LineStrips3D.from_fields(strips=strips))
        self._tape.fix(entities.WINDOW_PATH, rr.LineStrips3D.from_fields(strips=[]))

    def fix_truth(self, positions: Floats) -> None:
        """Log the true path; the last one logged is what the viewer shows."""
        self._tape.fix(entities.TRUE_PATH, rr.LineStrips3D.from_fields(strips=[positions]))

    def _add_pose(self, moment: Moment, pose: Floats, segment: int) -> None:
        self._tape.add(
            moment,
            entities.CAM0,
            rr.Transform3D,
            translation=pose[None, :3, 3],
            quaternion=quat_xyzw_from_rotation(pose[:3, :3])[None],
        )
        line = self._causal.extend(pose[:3, 3], segment)
        self._add_lines(moment, entities.CAUSAL_PATH, [] if line is None else [line])
        self._grow_frustum(moment, _FRUSTUM_SHARE_OF_PATH * float(np.linalg.norm(pose[:3, 3])))

    def _add_keyframes(self, moment: Moment, estimate: Estimate, shared: Mapping[int, int]) -> None:
        lines, window, settled = self._smoothed.update(estimate.keyframes)
        self._add_lines(moment, entities.SMOOTHED_PATH, lines)
        self._add_whole(moment, entities.WINDOW_PATH, window)
        neighbours = _closest(shared)
        edges = self._graph.update(estimate.keyframes, estimate.frame_index, neighbours)
        self._add_whole(moment, entities.GRAPH, list(edges))
        self._add_covariances(moment, settled)

    def _add_covariances(self, moment: Moment, keyframes: list[KeyframePose]) -> None:
        known = [k for k in keyframes if k.covariance is not None and k.covariance.any()]
        if not known:
            return
        shells = [_ellipsoid(keyframe) for keyframe in known]
        self._tape.add(
            moment,
            entities.COVARIANCE,
            rr.Ellipsoids3D,
            centers=np.array([k.world_from_cam0[:3, 3] for k in known]),
            half_sizes=np.array([half for half, _ in shells]),
            quaternions=np.array([quat for _, quat in shells]),
        )

    def _add_lines(self, moment: Moment, entity: str, lines: list[Floats]) -> None:
        if lines:
            self._add_whole(moment, entity, lines)

    def _add_whole(self, moment: Moment, entity: str, lines: list[Floats]) -> None:
        points = np.concatenate([np.empty((0, 3)), *lines]).astype(np.float32)
        strips = Strips(points, [len(line) for line in lines])
        self._tape.add(moment, entity, rr.LineStrips3D, strips=strips)

    def _add_landmarks(self, moment: Moment, landmarks: Landmarks, pose: Floats) -> None:
        local, settled = self._landmarks.update(landmarks, pose)
        self._add_points(moment, entities.LOCAL_LANDMARKS, local)
        if len(settled.xyz):
            self._add_points(moment, entities.SETTLED_LANDMARKS, settled)
        if len(landmarks.xyz):
            distances = np.linalg.norm(landmarks.xyz - pose[:3, 3], axis=1)
            self._grow_frustum(moment, _FRUSTUM_SHARE_OF_DEPTH * median(distances))

    def _add_points(self, moment: Moment, entity: str, points: Points) -> None:
        self._tape.add(
            moment,
            entity,
            rr.Points3D,
            positions=points.xyz.astype(np.float32),
            colors=points.colours,
            radii=points.radii,
        )

    def _grow_frustum(self, moment: Moment, size: float) -> None:
        """Keep the camera visible as the path grows; in steps, not in every frame."""
        if size > _FRUSTUM_STEP * self._frustum:
            self._frustum = size
            self._tape.add(moment, entities.LEFT, rr.Pinhole, image_plane_distance=[size])

    def _add_state(self, moment: Moment, state: State) -> None:
        """Turn the camera red while it is lost."""
        if state != self._state:
            self._state = state
            colour = entities.VERMILION if state == State.LOST else entities.GREEN
            self._tape.add(moment, entities.LEFT, rr.Pinhole, color=[colour])


def _closest(neighbours: Mapping[int, int]) -> tuple[int, ...]:
    """Those that share the most landmarks."""
    return tuple(sorted(neighbours, key=lambda frame: -neighbours[frame])[:_EDGES_PER_KEYFRAME])


def _ellipsoid(keyframe: KeyframePose) -> tuple[Floats, Floats]:
    """Half sizes (3,) and orientation (xyzw) of where the camera may be, in the world."""
    assert keyframe.covariance is not None
    variance, axes = np.linalg.eigh(keyframe.covariance[3:, 3:])
    turned = keyframe.world_from_cam0[:3, :3] @ axes
    turned[:, 0] *= np.sign(np.linalg.det(turned))  # eigenvectors may come out left-handed
    half_sizes = _SHOWN_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return half_sizes, quat_xyzw_from_rotation(turned)
