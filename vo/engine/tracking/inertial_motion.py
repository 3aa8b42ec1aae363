"""Prediction through lost frames by an inertial sensor whose states are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, se3_exp, se3_log
from vo.base.types import Floats
from vo.engine.inertial.prediction import InertialPredictor, KnownMotion
from vo.engine.tracking.gyro_motion import GyroMotion
from vo.engine.tracking.motion_model import MotionModel

_LAST_RAD = 0.002  # standard deviation of the rotation of the last tracked frame
_MAX_SQUARED = 10.0**2  # squared Mahalanobis distance of a measured pose from a predicted one


class Gap(NamedTuple):
    """Frames that were lost before one that was tracked.

    Attributes:
        first_ns: time of the tracked frame before them.
        last_ns: time of the tracked frame after them.
        known: motion before them.
    """

    first_ns: int
    last_ns: int
    known: KnownMotion


class PosePrior(NamedTuple):
    """A predicted pose and how certain it is.

    Attributes:
        world_from_cam: (4, 4).
        information: (6, 6) tangent on the right, rotation first.
    """

    world_from_cam: Floats
    information: Floats

    @property
    def covariance(self) -> Floats:
        """(6, 6) as `information`."""
        return np.asarray(np.linalg.inv(self.information), np.float64)

    def fused(self, cam_from_world: Floats, information: Floats) -> Floats:
        """cam_from_world (4, 4) of a measured pose and this one, weighted by their information.

        Args:
            cam_from_world: (4, 4) as measured.
            information: (6, 6) of that, for exp(xi) @ cam_from_world.
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


class InertialMotion:
    """Predicts as another model does, but from the second lost frame on by the sensor.

    So nothing changes where no frame is lost: a path of two cameras has the same bytes with and
    without the sensor.

    Attributes:
        gaps: those of the local map.

    Args:
        usual: predicts while frames are tracked.
        predictor: knows velocity, gravity and biases.
    """

    def __init__(self, usual: MotionModel, predictor: InertialPredictor) -> None:
        self.gaps: list[Gap] = []
        self._usual, self._predictor = usual, predictor
        self._last_ns = 0  # time of the newest tracked frame
        self._next_ns: int | None = None  # time of the frame after it, once it was predicted
        self._prior: tuple[int, PosePrior | None] | None = None
        self._has_map = False

    @property
    def last(self) -> Floats:
        """Pose of the newest tracked frame, the identity before the first."""
        return self._usual.last

    def rate(self, stamp_ns: int, readout_s: float) -> Floats | None:
        """(3,) rad/s by the gyroscope during the readout of an image; None if it is unknown."""
        usual = self._usual
        return usual.rate(stamp_ns, readout_s) if isinstance(usual, GyroMotion) else None

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Begin at a pose of unknown velocity, with a new map."""
        self._usual.restart(stamp_ns, world_from_cam)
        self._predictor.known = None
        self.gaps, self._has_map = [], True
        self._last_ns, self._next_ns, self._prior = stamp_ns, None, None

    def give_up(self) -> None:
        """Predict nothing by the sensor until there is a new map."""
        self._has_map = False

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Add the pose of a newly tracked frame."""
        if self.prior(stamp_ns) is not None and self._predictor.known is not None:
            self.gaps.append(Gap(self._last_ns, stamp_ns, self._predictor.known))
        self._usual.update(stamp_ns, world_from_cam)
        self._last_ns, self._next_ns, self._prior = stamp_ns, None, None

    def move(self, motion: Floats) -> None:
        """Follow the newest frame, which optimisation has moved by (4, 4) in the world."""
        self._usual.move(motion)
        self._prior = None

    def predict(self, stamp_ns: int) -> Floats:
        """Pose at a later time."""
        if self._next_ns is None:
            self._next_ns = stamp_ns
        prior = self.prior(stamp_ns)
        return self._usual.predict(stamp_ns) if prior is None else prior.world_from_cam

    def prior(self, stamp_ns: int) -> PosePrior | None:
        """The pose of a frame after lost ones; None if no frame was lost or nothing is known."""
        if not self._has_map or self._next_ns is None or stamp_ns <= self._next_ns:
            return None
        if self._prior is None or self._prior[0] != stamp_ns:
            self._prior = stamp_ns, self._predicted(stamp_ns)
        return self._prior[1]

    def of_lost(self, stamp_ns: int) -> PosePrior | None:
        """The pose of a frame that was not tracked, the first after a tracked one included."""
        prior = self.prior(stamp_ns)
        return self._predicted(stamp_ns) if prior is None and self._has_map else prior

    def _predicted(self, stamp_ns: int) -> PosePrior | None:
        motion = self._predictor.motion(self._predictor.known, self._last_ns, stamp_ns)
        if motion is None:
            return None
        covariance = motion.covariance + np.diag([_LAST_RAD**2] * 3 + [0.0] * 3)
        information = np.asarray(np.linalg.inv(covariance), np.float64)
        return PosePrior(self._usual.last @ motion.first_from_last, information)
