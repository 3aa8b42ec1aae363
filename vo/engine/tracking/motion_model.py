"""Prediction of the next pose: the contract, and constant velocity."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from vo.base.geometry.transforms import inverse, orthonormalised, se3_exp, se3_log
from vo.base.types import Floats


class MotionModel(Protocol):
    """Predicts the pose of the next frame. Poses are world_from_cam (4, 4)."""

    @property
    def last(self) -> Floats:
        """Pose of the newest tracked frame, the identity before the first."""
        ...

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Begin at a pose of unknown velocity, with a new map."""
        ...

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Add the pose of a newly tracked frame."""
        ...

    def move(self, motion: Floats) -> None:
        """Follow the newest frame, which optimisation has moved by (4, 4) in the world."""
        ...

    def predict(self, stamp_ns: int) -> Floats:
        """Pose at a later time."""
        ...


class ConstantVelocity:
    """Continues with the velocity between the last two poses, for any time between frames."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._world_from_cam: Floats = np.eye(4)
        # Motion (4, 4) to the newest pose from the one before it, and its time; None if unknown.
        self._moved: tuple[Floats, float] | None = None
        self._predicted: tuple[int, Floats] | None = None  # newest prediction and its time

    @property
    def last(self) -> Floats:
        """Pose of the newest tracked frame, the identity before the first."""
        return self._world_from_cam

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Begin at a pose of unknown velocity."""
        self._stamp_ns, self._world_from_cam = stamp_ns, world_from_cam
        self._moved = self._predicted = None

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Add the pose of a newly tracked frame."""
        elapsed_s = (stamp_ns - self._stamp_ns) * 1e-9
        if elapsed_s > 0:
            self._moved = inverse(self._world_from_cam) @ world_from_cam, elapsed_s
        self._stamp_ns, self._world_from_cam = stamp_ns, world_from_cam
        self._predicted = None

    def move(self, motion: Floats) -> None:
        """Move the newest pose by (4, 4) in the world; the velocity in its own frame stays."""
        self._world_from_cam = orthonormalised(motion @ self._world_from_cam)
        self._predicted = None

    def predict(self, stamp_ns: int) -> Floats:
        """Pose at a later time."""
        if self._moved is None:
            return self._world_from_cam
        if self._predicted is None or self._predicted[0] != stamp_ns:  # asked for several times
            moved, before_s = self._moved
            elapsed_s = (stamp_ns - self._stamp_ns) * 1e-9
            twist = se3_log(moved) / before_s * elapsed_s
            pose = np.asarray(self._world_from_cam @ se3_exp(twist))
            self._predicted = stamp_ns, pose
        return self._predicted[1]
