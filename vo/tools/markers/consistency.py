"""Ambiguous poses of a recording, decided by those before and after them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vo.base.geometry.transforms import rotation_angle
from vo.base.types import Floats
from vo.tools.markers.image_markers import FrameMarkers, Marker, PlanePose

_MAX_GAP_NS = 500_000_000  # between two views of a marker that belong together
_RATE_DEG_PER_S = 90.0  # standard deviation of the rotation of a marker relative to the camera
_MIN_SIGMA_DEG = 2.0
_MAX_COST = 60.0  # of a rotation between two frames: a jump is possible


def consistent(frames: Sequence[FrameMarkers]) -> list[FrameMarkers]:
    """The same markers, each with that of its two poses which fits the views around it best.

    The most likely sequence of poses of each marker is found by dynamic programming (Viterbi): the
    other pose costs its `evidence`, and rotations cost by their angle and the time between them.
    `evidence` becomes the difference to the best sequence with the other pose in this frame.
    Frames with several markers of one id are left as they are.
    """
    chosen: dict[tuple[int, int], PlanePose] = {}
    for track in _tracks(frames):
        poses = [_pose_of(frames[row], number) for row, number in track]
        stamps = np.array([frames[row].stamp_ns for row, _ in track])
        for place, pose in zip(track, _decided(poses, stamps), strict=True):
            chosen[place] = pose
    result = []
    for row, frame in enumerate(frames):
        markers = tuple(_with(each, chosen.get((row, each.id))) for each in frame.markers)
        result.append(replace(frame, markers=markers))
    return result


def swapped(pose: PlanePose) -> PlanePose:
    """The same with its two solutions exchanged; the covariance stays that of the first."""
    assert pose.other is not None
    return replace(
        pose,
        cam_from_marker=pose.other,
        other=pose.cam_from_marker,
        error_px=pose.other_error_px,
        other_error_px=pose.error_px,
        evidence=-pose.evidence,
    )


def _tracks(frames: Sequence[FrameMarkers]) -> list[list[tuple[int, int]]]:
    """Rows of frames and ids, of markers seen again and again."""
    tracks: list[list[tuple[int, int]]] = []
    newest: dict[int, list[tuple[int, int]]] = {}
    for row, frame in enumerate(frames):
        repeated = frame.repeated_ids
        for marker in frame.markers:
            if marker.pose is None or marker.id in repeated:
                continue
            track = newest.get(marker.id)
            if track is None or frame.stamp_ns - frames[track[-1][0]].stamp_ns > _MAX_GAP_NS:
                track = newest[marker.id] = []
                tracks.append(track)
            track.append((row, marker.id))
    return tracks


def _pose_of(frame: FrameMarkers, number: int) -> PlanePose:
    (pose,) = [marker.pose for marker in frame.markers if marker.id == number]
    assert pose is not None
    return pose


def _with(marker: Marker, pose: PlanePose | None) -> Marker:
    return marker if pose is None else replace(marker, pose=pose)


def _decided(poses: Sequence[PlanePose], stamps_ns: Floats) -> list[PlanePose]:
    unary = np.array([[0.0, each.evidence if each.other is not None else np.inf] for each in poses])
    steps = [
        _step_costs(before, after, 1e-9 * float(gap))
        for before, after, gap in zip(poses, poses[1:], np.diff(stamps_ns), strict=False)
    ]
    forward, backward = unary.copy(), unary.copy()
    for row, costs in enumerate(steps, 1):
        forward[row] += (forward[row - 1][:, None] + costs).min(axis=0)
    for row in range(len(poses) - 2, -1, -1):
        backward[row] += (backward[row + 1] + steps[row]).min(axis=1)
    total = forward + backward - np.where(np.isfinite(unary), unary, 0.0)
    decided = []
    for pose, (first, second) in zip(poses, total.tolist(), strict=True):
        is_other = second < first
        better = swapped(pose) if is_other else pose
        decided.append(replace(better, evidence=abs(second - first)))
    return decided


def _step_costs(before: PlanePose, after: PlanePose, gap_s: float) -> Floats:
    """(2, 2) costs of the rotation from each solution of a view to each of the next one."""
    sigma = np.deg2rad(np.hypot(_RATE_DEG_PER_S * gap_s, _MIN_SIGMA_DEG))
    costs = np.full((2, 2), np.inf)
    for i, first in enumerate((before.cam_from_marker, before.other)):
        for j, second in enumerate((after.cam_from_marker, after.other)):
            if first is not None and second is not None:
                angle = rotation_angle(second[:3, :3] @ first[:3, :3].T)
                costs[i, j] = min((angle / sigma) ** 2, _MAX_COST)
    return costs
