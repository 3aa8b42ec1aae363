"""Prediction of the next pose: the contract, and constant velocity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from vo.base.geometry.transforms import inverse, orthonormalised, se3_exp, se3_log
from vo.base.types import Floats

if TYPE_CHECKING:
    from vo.engine.inertial.prediction import Gap

_MAX_AHEAD_NS = 1_000_000_000  # after the newest tracked frame, without an inertial sensor
_MAX_SQUARED = 10.0**2  # squared Mahalanobis distance of a measured pose from a predicted one


class PosePrior(NamedTuple):
    """A predicted pose and how certain it is."""

    world_from_cam: Floats  # (4, 4)
    information: Floats  # (6, 6) tangent on the right, rotation first
    # whether a measured pose that contradicts it is wrong, and not another place
    leads: bool = False

    @property
    def covariance(self) -> Floats:
        """(6, 6) as `information`."""
        return np.asarray(np.linalg.inv(self.information), np.float64)

    def fused(self, cam_from_world: Floats, information: Floats) -> Floats:
        """cam_from_world (4, 4) of a measured pose and this one, weighted by their information.

        `information`: (6, 6) for exp(xi) @ cam_from_world.
        """
        off = se3_log(inverse(self.world_from_cam) @ inverse(cam_from_world))
        # A tangent on the right of world_from_cam is the negative one on the left of its inverse.
        weighted = self.information @ off
        step = np.linalg.solve(information + self.information, weighted)
        return np.asarray(se3_exp(np.asarray(step, np.float64)) @ cam_from_world)

    def is_contradicted(self, cam_from_world: Floats, information: Floats) -> bool:
        """Whether a measured pose with its information cannot be reconciled with this one."""
        off = se3_log(inverse(self.world_from_cam) @ inverse(cam_from_world))
        # The information on a difference: (A^-1 + B^-1)^-1 = A (A + B)^-1 B.
        both = np.linalg.solve(information + self.information, information @ off)
        return float(off @ self.information @ both) > _MAX_SQUARED


class MotionModel(Protocol):
    """Predicts the pose of the next frame; poses are world_from_cam (4, 4).

    What only an inertial sensor knows is unknown by default.
    """

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

    def ahead(self, stamp_ns: int) -> Floats | PosePrior | None:
        """Pose at a later time for programs; no other result depends on whether it is asked."""
        return self.predict(stamp_ns)

    @property
    def gaps(self) -> Sequence[Gap]:
        """Lost frames between tracked ones of the local map through which a sensor predicts."""
        return ()

    def prior(self, stamp_ns: int) -> PosePrior | None:
        """The pose of a frame after lost ones; None if no frame was lost or nothing is known."""
        return None

    def of_lost(self, stamp_ns: int) -> PosePrior | None:
        """The pose of a frame that was not tracked, the first after a tracked one included."""
        return None

    def rate(self, stamp_ns: int, readout_s: float) -> Floats | None:
        """(3,) rad/s of the camera while rows are read around a time; None if it is unknown."""
        return None

    def give_up(self) -> None:
        """Predict nothing by a sensor until there is a new map."""
        return


class ConstantVelocity(MotionModel):
    """Continues with the velocity between the last two poses, for any time between frames."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._world_from_cam: Floats = np.eye(4)
        # Motion (4, 4) to the newest pose from the one before it, and its time; None if unknown.
        self._moved: tuple[Floats, float] | None = None
        self._predicted: tuple[int, Floats] | None = None  # newest prediction and its time

    @property
    def last(self) -> Floats:
        """See `MotionModel.last`."""
        return self._world_from_cam

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """See `MotionModel.restart`."""
        self._stamp_ns, self._world_from_cam = stamp_ns, world_from_cam
        self._moved = self._predicted = None

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """See `MotionModel.update`."""
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
        """See `MotionModel.predict`."""
        if self._moved is None:
            return self._world_from_cam
        if self._predicted is None or self._predicted[0] != stamp_ns:  # asked for several times
            moved, before_s = self._moved
            elapsed_s = (stamp_ns - self._stamp_ns) * 1e-9
            twist = se3_log(moved) / before_s * elapsed_s
            pose = np.asarray(self._world_from_cam @ se3_exp(twist))
            self._predicted = stamp_ns, pose
        return self._predicted[1]

    def ahead(self, stamp_ns: int) -> Floats | None:
        """See `MotionModel.ahead`; None where the velocity is unknown or too old."""
        is_recent = stamp_ns - self._stamp_ns <= _MAX_AHEAD_NS
        return self.predict(stamp_ns) if is_recent and self._moved is not None else None
