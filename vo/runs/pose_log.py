"""Causal poses, which never change."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import whole_transforms
from vo.base.types import Floats, Trajectory
from vo.engine.trajectory.table import Table

_POSE = np.dtype([("stamp_ns", np.int64), ("world_from_cam", np.float64, (3, 4))])


class PoseLog:
    """Stamps and poses in time order."""

    def __init__(self) -> None:
        self._table = Table(_POSE)

    def append(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Append a pose (4, 4)."""
        self._table.append(stamp_ns, world_from_cam[:3])

    def trajectory(self) -> Trajectory:
        """All poses."""
        rows = self._table.rows
        return Trajectory(rows["stamp_ns"].copy(), whole_transforms(rows["world_from_cam"]))
