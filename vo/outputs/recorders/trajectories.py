"""Moments and segments of the recorded frames, and complete trajectories as rows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Estimate, Floats, Trajectory
from vo.outputs.recorders.batch import Batch
from vo.outputs.recorders.timelines import Moment

_POSE_NAMES = ["tx", "ty", "tz", "qx", "qy", "qz", "qw"]


class RunIndex:
    """The frames recorded so far: their moments, and the ends of segments."""

    def __init__(self) -> None:
        self._moments: dict[int, Moment] = {}
        self._last_stamp: dict[int, int] = {}  # of the causal poses of each segment

    def __len__(self) -> int:
        return len(self._moments)

    def add(self, estimate: Estimate) -> Moment:
        """Add a frame; its moment."""
        moment = Moment(estimate.frame_index, estimate.stamp_ns)
        self._moments[estimate.stamp_ns] = moment
        if estimate.world_from_cam0 is not None:
            self._last_stamp[estimate.segment] = estimate.stamp_ns
        return moment

    @property
    def first(self) -> Moment:
        """The oldest frame."""
        return self._moments[next(iter(self._moments))]

    @property
    def last(self) -> Moment:
        """The newest frame."""
        return self._moments[next(reversed(self._moments))]

    @property
    def by_frame(self) -> dict[int, Moment]:
        """The moments by number of their frame."""
        return {moment.frame_index: moment for moment in self._moments.values()}

    def moment(self, stamp_ns: int) -> Moment | None:
        """The moment of the frame with this stamp, None if it was not recorded."""
        return self._moments.get(stamp_ns)

    def by_segment(self, trajectory: Trajectory) -> list[Trajectory]:
        """A trajectory divided at the ends of segments; empty pieces are left out.

        Not at their beginnings: frames before the first mono map may get a pose in it later.
        """
        return [piece for _, piece in self._pieces(trajectory)]

    def by_world(self, trajectory: Trajectory, worlds: Mapping[int, int]) -> list[Trajectory]:
        """A trajectory as `by_segment`, with the segments of each world together.

        `worlds`: number of the world of each segment that was connected to another one.
        """
        found: dict[int, list[Trajectory]] = {}
        for segment, piece in self._pieces(trajectory):
            found.setdefault(worlds.get(segment, segment), []).append(piece)
        return [
            Trajectory(
                np.concatenate([piece.stamps_ns for piece in pieces]),
                np.concatenate([piece.world_from_cam for piece in pieces]),
            )
            for pieces in found.values()
        ]

    def _pieces(self, trajectory: Trajectory) -> list[tuple[int, Trajectory]]:
        """Segments that are not empty, with their numbers."""
        ends = list(self._last_stamp.values())[:-1]
        cuts = np.searchsorted(trajectory.stamps_ns, ends, side="right")
        stamps = np.split(trajectory.stamps_ns, cuts)
        poses = np.split(trajectory.world_from_cam, cuts)
        rows = zip(list(self._last_stamp) or [0], stamps, poses, strict=True)
        return [(segment, Trajectory(stamp, pose)) for segment, stamp, pose in rows if len(stamp)]


def add_trajectory(batch: Batch, entity: str, trajectory: Trajectory, index: RunIndex) -> None:
    """Add poses as rows of seven float64 (tx ty tz qx qy qz qw); transforms are only float32."""
    batch.log_static(entity, rr.SeriesLines(names=_POSE_NAMES))
    for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), _pose_rows(trajectory), strict=True):
        moment = index.moment(stamp_ns)
        if moment is not None:
            batch.add(moment, entity, rr.Scalars, scalars=row)


def _pose_rows(trajectory: Trajectory) -> Floats:
    quats = [quat_xyzw_from_rotation(pose[:3, :3]) for pose in trajectory.world_from_cam]
    return np.concatenate([trajectory.positions, np.array(quats).reshape(-1, 4)], axis=1)
