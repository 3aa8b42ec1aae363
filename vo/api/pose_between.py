"""The pose between frames, by interpolation."""

from __future__ import annotations

from bisect import bisect_left

from vo.base.geometry.transforms import interpolate
from vo.base.types import PredictedPose
from vo.engine.trajectory.inertial_frames import TURNED
from vo.engine.trajectory.store import TrajectoryStore

_MAX_GAP_NS = 1_000_000_000  # between the frames


def pose_between(store: TrajectoryStore, stamp_ns: int) -> PredictedPose | None:
    """The pose at the time of a frame, or between two of a segment up to 1 s apart."""
    frames, stamps = store.frames, store.frames["stamp_ns"]
    row = bisect_left(stamps, stamp_ns)
    first = row if row < len(stamps) and stamps[row] == stamp_ns else row - 1
    if first < 0 or row == len(stamps) or (frames["fraction"][first : row + 1] == TURNED).any():
        return None
    begin, end = int(stamps[first]), int(stamps[row])
    if frames["segment"][first] != frames["segment"][row] or end - begin > _MAX_GAP_NS:
        return None
    poses = store.trajectory(first).world_from_cam
    if first == row:
        return PredictedPose(poses[0], None)
    fraction = (stamp_ns - begin) / (end - begin)
    return PredictedPose(interpolate(poses[0], poses[1], fraction), None)
