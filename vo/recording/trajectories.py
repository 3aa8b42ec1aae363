"""Which frame is which moment of a run, and whole trajectories as columns."""

from __future__ import annotations

import numpy as np
import rerun as rr

from vo.geometry.transforms import quat_xyzw_from_rotation
from vo.recording import entities
from vo.types import Estimate, Floats, Ints, Trajectory

_EARLIEST_EPOCH_NS = 10**17  # March 1973: smaller stamps count from the start of something else
_POSE_NAMES = ["tx", "ty", "tz", "qx", "qy", "qz", "qw"]


class RunIndex:
    """The frames recorded so far: their numbers, stamps, and where segments begin."""

    def __init__(self) -> None:
        self._frame_of_stamp: dict[int, int] = {}
        self._segment = -1
        self._segment_starts: list[int] = []
        self._counts_from_epoch: bool | None = None

    def __len__(self) -> int:
        return len(self._frame_of_stamp)

    def add(self, estimate: Estimate) -> None:
        """Take in a frame."""
        if self._counts_from_epoch is None:
            self._counts_from_epoch = estimate.stamp_ns >= _EARLIEST_EPOCH_NS
        self._frame_of_stamp[estimate.stamp_ns] = estimate.frame_index
        if estimate.world_from_cam0 is not None and estimate.segment != self._segment:
            self._segment = estimate.segment
            self._segment_starts.append(estimate.stamp_ns)

    def set_time(self, stream: rr.RecordingStream, estimate: Estimate) -> None:
        """Make `estimate`'s moment the time of what is logged next."""
        stream.set_time(entities.FRAME_TIMELINE, sequence=estimate.frame_index)
        if self._counts_from_epoch:
            moment = np.datetime64(estimate.stamp_ns, "ns")
            stream.set_time(entities.SENSOR_TIMELINE, timestamp=moment)
        else:
            span = np.timedelta64(estimate.stamp_ns, "ns")
            stream.set_time(entities.SENSOR_TIMELINE, duration=span)

    def time_columns(self, stamps_ns: Ints) -> list[rr.TimeColumn]:
        """Both timelines for rows that belong to recorded frames."""
        frames = [self._frame_of_stamp[stamp] for stamp in stamps_ns.tolist()]
        name = entities.SENSOR_TIMELINE
        if self._counts_from_epoch:
            sensor = rr.TimeColumn(name, timestamp=stamps_ns.astype("datetime64[ns]"))
        else:
            sensor = rr.TimeColumn(name, duration=stamps_ns.astype("timedelta64[ns]"))
        return [rr.TimeColumn(entities.FRAME_TIMELINE, sequence=frames), sensor]

    def recorded(self, trajectory: Trajectory) -> Trajectory:
        """The part of a trajectory whose frames were recorded."""
        known = np.array([stamp in self._frame_of_stamp for stamp in trajectory.stamps_ns.tolist()])
        kept = known.astype(np.bool_)
        return Trajectory(trajectory.stamps_ns[kept], trajectory.world_from_cam[kept])

    def by_segment(self, trajectory: Trajectory) -> list[Trajectory]:
        """A trajectory cut where segments begin; empty pieces are left out."""
        cuts = np.searchsorted(trajectory.stamps_ns, self._segment_starts[1:])
        stamps = np.split(trajectory.stamps_ns, cuts)
        poses = np.split(trajectory.world_from_cam, cuts)
        pairs = zip(stamps, poses, strict=True)
        return [Trajectory(stamp, pose) for stamp, pose in pairs if len(stamp)]


def log_trajectory(
    stream: rr.RecordingStream, entity: str, trajectory: Trajectory, index: RunIndex
) -> None:
    """Log poses as rows of seven float64 (tx ty tz qx qy qz qw): transforms hold only float32."""
    trajectory = index.recorded(trajectory)
    if not len(trajectory):
        return
    stream.log(entity, rr.SeriesLines(names=_POSE_NAMES), static=True)
    rows = _pose_rows(trajectory)
    columns = rr.Scalars.columns(scalars=rows.reshape(-1)).partition([rows.shape[1]] * len(rows))
    stream.send_columns(entity, index.time_columns(trajectory.stamps_ns), columns)


def _pose_rows(trajectory: Trajectory) -> Floats:
    quats = np.array([quat_xyzw_from_rotation(pose[:3, :3]) for pose in trajectory.world_from_cam])
    return np.concatenate([trajectory.positions, quats], axis=1)
