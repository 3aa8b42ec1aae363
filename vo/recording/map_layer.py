"""The world: camera, paths and landmarks."""

from __future__ import annotations

import numpy as np
import rerun as rr

from vo.geometry.transforms import quat_xyzw_from_rotation
from vo.recording import entities
from vo.recording.scene import GrowingMap, GrowingPath, Points, SmoothedPath
from vo.recording.trajectories import RunIndex
from vo.recording.truth import laid_onto_path, laid_onto_pose
from vo.types import Estimate, Floats, Landmarks, State, Trajectory

_PATHS = {
    entities.CAUSAL_PATH: (entities.ORANGE, 1.2),
    entities.SMOOTHED_PATH: (entities.SKY, 2.0),
    entities.WINDOW: (entities.PINK, 2.5),
    entities.TRUE_PATH: (entities.GREY, 1.2),
}
_FRUSTUM_SHARE_OF_DEPTH = 0.1
_FRUSTUM_SHARE_OF_PATH = 0.04
_FRUSTUM_STEP = 1.25
_FRAMES_BETWEEN_MAPS = 5  # the local map is the largest thing after the image


class MapLayer:
    """Logs the camera, the paths and the landmarks of each frame.

    Args:
        stream: where to log.
        truth: the true path, if known.
        is_metric: whether the estimate's lengths are metres, so that the truth has its scale.
    """

    def __init__(
        self, stream: rr.RecordingStream, truth: Trajectory | None, *, is_metric: bool
    ) -> None:
        self._stream = stream
        self._truth = truth if truth is not None and len(truth) else None
        self._is_metric = is_metric
        self._has_shown_truth = False
        self._causal = GrowingPath()
        self._smoothed = SmoothedPath()
        self._landmarks = GrowingMap()
        self._next_map_frame = 0
        self._frustum = 0.0
        self._state: State | None = None

    def log_styles(self) -> None:
        """Log the axes, and the colours and sizes that never change."""
        self._stream.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
        for entity, (colour, radius) in _PATHS.items():
            style = rr.LineStrips3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(radius))
            self._stream.log(entity, style, static=True)
        for entity, radius in ((entities.LOCAL_LANDMARKS, 2.0), (entities.SETTLED_LANDMARKS, 1.2)):
            dots = rr.Points3D.from_fields(radii=rr.Radius.ui_points(radius))
            self._stream.log(entity, dots, static=True)

    def log(self, estimate: Estimate) -> None:
        """Log what a frame adds to the world."""
        self._log_state(estimate.state)
        pose = estimate.world_from_cam0
        if pose is not None:
            self._log_pose(pose, estimate)
        if estimate.keyframes:
            settled, window = self._smoothed.update(estimate.keyframes)
            self._log_lines(entities.SMOOTHED_PATH, settled)
            self._stream.log(entities.WINDOW, rr.LineStrips3D.from_fields(strips=window))
        is_map_due = estimate.frame_index >= self._next_map_frame
        if estimate.landmarks is not None and pose is not None and is_map_due:
            self._next_map_frame = estimate.frame_index + _FRAMES_BETWEEN_MAPS
            self._log_landmarks(estimate.landmarks, pose)

    def log_whole(self, smoothed: Trajectory, index: RunIndex) -> None:
        """Log the final path in place of the growing one, and the truth laid onto it."""
        pieces = index.by_segment(smoothed)
        if not pieces:
            return
        strips = [piece.positions for piece in pieces]
        self._stream.log(
            entities.SMOOTHED_PATH, rr.LineStrips3D.from_fields(strips=strips), static=True
        )
        self._stream.log(entities.WINDOW, rr.LineStrips3D.from_fields(strips=[]), static=True)
        if self._truth is not None:
            longest = max(pieces, key=len)
            scaled = not self._is_metric
            self._log_truth(laid_onto_path(self._truth, longest, with_scale=scaled))

    def _log_pose(self, pose: Floats, estimate: Estimate) -> None:
        transform = rr.Transform3D(
            translation=pose[:3, 3],
            quaternion=rr.Quaternion(xyzw=quat_xyzw_from_rotation(pose[:3, :3])),
        )
        self._stream.log(entities.CAMERA, transform)
        line = self._causal.extend(pose[:3, 3], estimate.segment)
        self._log_lines(entities.CAUSAL_PATH, [] if line is None else [line])
        self._grow_frustum(_FRUSTUM_SHARE_OF_PATH * float(np.linalg.norm(pose[:3, 3])))
        if self._truth is not None and self._is_metric and not self._has_shown_truth:
            self._log_truth(laid_onto_pose(self._truth, estimate.stamp_ns, pose))

    def _log_truth(self, positions: Floats | None) -> None:
        """Log the true path; the last one logged is what the viewer shows."""
        if positions is None:
            return
        self._has_shown_truth = True
        path = rr.LineStrips3D.from_fields(strips=[positions])
        self._stream.log(entities.TRUE_PATH, path, static=True)

    def _log_lines(self, entity: str, lines: list[Floats]) -> None:
        if lines:
            self._stream.log(entity, rr.LineStrips3D.from_fields(strips=lines))

    def _log_landmarks(self, landmarks: Landmarks, pose: Floats) -> None:
        local, settled = self._landmarks.update(landmarks, pose)
        self._log_points(entities.LOCAL_LANDMARKS, local)
        if len(settled.xyz):
            self._log_points(entities.SETTLED_LANDMARKS, settled)
        if len(landmarks.xyz):
            distances = np.linalg.norm(landmarks.xyz - pose[:3, 3], axis=1)
            self._grow_frustum(_FRUSTUM_SHARE_OF_DEPTH * float(np.median(distances)))

    def _log_points(self, entity: str, points: Points) -> None:
        dots = rr.Points3D.from_fields(positions=points.xyz, colors=points.colours)
        self._stream.log(entity, dots)

    def _grow_frustum(self, size: float) -> None:
        """Keep the camera visible as the path grows; in steps, not in every frame."""
        if size > _FRUSTUM_STEP * self._frustum:
            self._frustum = size
            self._stream.log(entities.CAMERA, rr.Pinhole.from_fields(image_plane_distance=size))

    def _log_state(self, state: State) -> None:
        """Turn the camera red while it is lost."""
        if state != self._state:
            self._state = state
            colour = entities.VERMILION if state == State.LOST else entities.GREEN
            self._stream.log(entities.CAMERA, rr.Pinhole.from_fields(color=colour))
