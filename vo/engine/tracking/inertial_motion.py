"""Prediction through lost frames by an inertial sensor whose states are known."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats
from vo.engine.inertial.prediction import InertialPredictor
from vo.engine.tracking.motion_model import Gap, MotionModel, PosePrior

_LAST_RAD = 0.002  # standard deviation of the rotation of the last tracked frame


class InertialMotion(MotionModel):
    """Predicts as another model does, but from the second lost frame on by the sensor.

    So nothing changes where no frame is lost: a path of two cameras has the same bytes with and
    without the sensor.
    """

    def __init__(self, usual: MotionModel, predictor: InertialPredictor) -> None:
        self._gaps: list[Gap] = []
        self._usual, self._predictor = usual, predictor
        self._last_ns = 0  # time of the newest tracked frame
        self._next_ns: int | None = None  # time of the frame after it, once it was predicted
        self._prior: tuple[int, PosePrior | None] | None = None
        self._has_map = False

    @property
    def last(self) -> Floats:
        """See `MotionModel.last`."""
        return self._usual.last

    @property
    def gaps(self) -> list[Gap]:
        """See `MotionModel.gaps`."""
        return self._gaps

    def rate(self, stamp_ns: int, readout_s: float) -> Floats | None:
        """See `MotionModel.rate`."""
        return self._usual.rate(stamp_ns, readout_s)

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """See `MotionModel.restart`."""
        self._usual.restart(stamp_ns, world_from_cam)
        self._predictor.known = None
        self._gaps, self._has_map = [], True
        self._last_ns, self._next_ns, self._prior = stamp_ns, None, None

    def give_up(self) -> None:
        """See `MotionModel.give_up`."""
        self._has_map = False

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """See `MotionModel.update`."""
        if self.prior(stamp_ns) is not None and self._predictor.known is not None:
            self._gaps.append(Gap(self._last_ns, stamp_ns, self._predictor.known))
        self._usual.update(stamp_ns, world_from_cam)
        self._last_ns, self._next_ns, self._prior = stamp_ns, None, None

    def move(self, motion: Floats) -> None:
        """See `MotionModel.move`."""
        self._usual.move(motion)
        self._prior = None

    def predict(self, stamp_ns: int) -> Floats:
        """See `MotionModel.predict`."""
        if self._next_ns is None:
            self._next_ns = stamp_ns
        prior = self.prior(stamp_ns)
        return self._usual.predict(stamp_ns) if prior is None else prior.world_from_cam

    def prior(self, stamp_ns: int) -> PosePrior | None:
        """See `MotionModel.prior`."""
        if not self._has_map or self._next_ns is None or stamp_ns <= self._next_ns:
            return None
        if self._prior is None or self._prior[0] != stamp_ns:
            self._prior = stamp_ns, self._predicted(stamp_ns)
        return self._prior[1]

    def of_lost(self, stamp_ns: int) -> PosePrior | None:
        """See `MotionModel.of_lost`."""
        prior = self.prior(stamp_ns)
        return self._predicted(stamp_ns) if prior is None and self._has_map else prior

    def _predicted(self, stamp_ns: int) -> PosePrior | None:
        motion = self._predictor.motion(self._predictor.known, self._last_ns, stamp_ns)
        if motion is None:
            return None
        covariance = motion.covariance + np.diag([_LAST_RAD**2] * 3 + [0.0] * 3)
        information = np.asarray(np.linalg.inv(covariance), np.float64)
        return PosePrior(self._usual.last @ motion.first_from_last, information)
