"""Prediction of poses by an inertial sensor: rotations, and through lost frames."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import so3_log
from vo.base.types import Floats
from vo.engine.inertial.estimation import QUICK_RAD_S
from vo.engine.inertial.prediction import Gap, InertialPredictor, RelativeMotion
from vo.engine.inertial.preintegration import rotation_of
from vo.engine.inertial.samples import SampleReader
from vo.engine.tracking.motion_model import ConstantVelocity, MotionModel, PosePrior

_MEMORY = 50  # frames over which the bias is averaged
_MIN_FRAMES = 10  # compared before the gyroscope is trusted
_FORGETTING = 0.95  # factor for each frame
# Maximum ratio of the squared differences from the rotations by images to these rotations.
_MAX_ERROR_RATIO = 0.1


class GyroMotion(MotionModel):
    """Turns as the gyroscope does, and moves on with the last velocity in the world.

    It predicts as with constant velocity where samples are missing, and until the rotations of
    tracked frames have confirmed the gyroscope: one with wrong axes, units or times never is. The
    bias is the mean difference to these rotations.
    """

    def __init__(self, reader: SampleReader, imu_from_cam: Floats) -> None:
        self._visual = ConstantVelocity()
        self._reader = reader
        self._imu_from_cam = imu_from_cam[:3, :3]
        self._stamp_ns: int | None = None
        self._velocity: Floats | None = None  # (3,) in the world, map units a second
        self._bias: Floats = np.zeros(3)
        self._count = 0
        self._turned = self._missed = 0.0  # sums of squared rates by images, and of differences
        self._predicted: tuple[int, Floats] | None = None
        self._turned_until: tuple[int, Floats | None] | None = None  # since the newest frame

    @property
    def last(self) -> Floats:
        """See `MotionModel.last`."""
        return self._visual.last

    @property
    def is_trusted(self) -> bool:
        """Whether images have confirmed the gyroscope."""
        return self._count >= _MIN_FRAMES and self._missed < _MAX_ERROR_RATIO * self._turned

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """See `MotionModel.restart`."""
        self._visual.restart(stamp_ns, world_from_cam)
        self._stamp_ns, self._velocity = stamp_ns, None
        self._predicted = self._turned_until = None

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """See `MotionModel.update`."""
        before, last_ns = self._visual.last, self._stamp_ns
        if last_ns is not None and stamp_ns > last_ns:
            elapsed_s = 1e-9 * (stamp_ns - last_ns)
            self._velocity = (world_from_cam[:3, 3] - before[:3, 3]) / elapsed_s
            self._learn_bias(last_ns, stamp_ns, before[:3, :3].T @ world_from_cam[:3, :3])
        self._visual.update(stamp_ns, world_from_cam)
        self._stamp_ns, self._predicted, self._turned_until = stamp_ns, None, None

    def move(self, motion: Floats) -> None:
        """See `MotionModel.move`."""
        if self._velocity is not None:
            self._velocity = motion[:3, :3] @ self._velocity
        self._visual.move(motion)
        self._predicted = None

    def predict(self, stamp_ns: int) -> Floats:
        """See `MotionModel.predict`."""
        if self._predicted is not None and self._predicted[0] == stamp_ns:
            return self._predicted[1]
        pose = None
        if self.is_trusted and self._velocity is not None and self._stamp_ns is not None:
            turn = self._turn(self._stamp_ns, stamp_ns)
            if turn is not None:
                pose = self._visual.last.copy()
                pose[:3, :3] = pose[:3, :3] @ turn
                pose[:3, 3] += self._velocity * (1e-9 * (stamp_ns - self._stamp_ns))
        if pose is None:
            pose = self._visual.predict(stamp_ns)
        self._predicted = stamp_ns, pose
        return pose

    def ahead(self, stamp_ns: int) -> Floats | None:
        """See `MotionModel.ahead`."""
        return self._visual.ahead(stamp_ns)

    def rate(self, stamp_ns: int, readout_s: float) -> Floats | None:
        """See `MotionModel.rate`."""
        half_ns = round(0.5e9 * readout_s)
        if not self.is_trusted or half_ns == 0:
            return None
        interval = self._reader.between(stamp_ns - half_ns, stamp_ns + half_ns)
        if interval is None:
            return None
        turn = so3_log(rotation_of(interval, self._bias)) / interval.duration_s
        return np.asarray(self._imu_from_cam.T @ turn)

    def _turn(self, first_ns: int, last_ns: int) -> Floats | None:
        """(3, 3) first_from_last of the camera since the newest frame; None without samples."""
        if self._turned_until is None or self._turned_until[0] != last_ns:
            interval, turn = self._reader.between(first_ns, last_ns), None
            if interval is not None:
                turn = self._imu_from_cam.T @ rotation_of(interval, self._bias) @ self._imu_from_cam
            self._turned_until = last_ns, turn
        return self._turned_until[1]

    def _learn_bias(self, first_ns: int, last_ns: int, visual: Floats) -> None:
        turn = self._turn(first_ns, last_ns)
        if turn is None:
            return
        per_s = 1e9 / (last_ns - first_ns)
        off, rate = so3_log(visual.T @ turn) * per_s, so3_log(visual) * per_s
        self._turned = _FORGETTING * self._turned + float(rate @ rate)
        self._missed = _FORGETTING * self._missed + float(off @ off)
        self._count = min(self._count + 1, _MEMORY)
        self._bias = self._bias + self._imu_from_cam @ off / self._count


# Standard deviation of the rotation of the last tracked frame; in a quick turn new landmarks have
# its error, too.
_LAST_RAD, _LAST_TURNING_RAD = 0.002, 0.0003
_AFTER_TURN_NS = 300_000_000  # until landmarks that came into view in it have a parallax


class InertialMotion(MotionModel):
    """Predicts as another model does, but by the sensor after lost frames and in quick turns.

    So nothing changes where neither happens: a path of two cameras without lost frames has the
    same bytes with and without the sensor.
    """

    def __init__(
        self, usual: MotionModel, predictor: InertialPredictor, *, is_metric: bool = True
    ) -> None:
        self._gaps: list[Gap] = []
        self._is_metric, self._turning_until_ns = is_metric, 0
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
        if not self._has_map:
            return None
        if self._prior is None or self._prior[0] != stamp_ns:
            prior = None
            if self._next_ns is not None and stamp_ns > self._next_ns:
                prior = self._predicted(stamp_ns, _LAST_RAD)
            elif self._turns_quickly(stamp_ns):
                prior = self._predicted(stamp_ns, _LAST_TURNING_RAD)
                prior = prior and prior._replace(leads=True)
            self._prior = stamp_ns, prior
        return self._prior[1]

    def _turns_quickly(self, stamp_ns: int) -> bool:
        """Whether the view of a single camera changes, or has, before landmarks have a depth."""
        turned = None if self._is_metric else self._predictor.turned(self._last_ns, stamp_ns)
        elapsed_s = 1e-9 * (stamp_ns - self._last_ns)
        if turned is not None and np.linalg.norm(so3_log(turned)) > QUICK_RAD_S * elapsed_s:
            self._turning_until_ns = stamp_ns + _AFTER_TURN_NS
        return stamp_ns <= self._turning_until_ns

    def of_lost(self, stamp_ns: int) -> PosePrior | None:
        """See `MotionModel.of_lost`."""
        prior = self.prior(stamp_ns)
        return self._predicted(stamp_ns, _LAST_RAD) if prior is None and self._has_map else prior

    def ahead(self, stamp_ns: int) -> Floats | PosePrior | None:
        """See `MotionModel.ahead`; None after a map was given up."""
        if not self._has_map:
            return None
        prior = self._prior_of(self._predictor.ahead(self._last_ns, stamp_ns), _LAST_RAD)
        return self._usual.ahead(stamp_ns) if prior is None else prior

    def _predicted(self, stamp_ns: int, last_rad: float) -> PosePrior | None:
        motion = self._predictor.motion(self._predictor.known, self._last_ns, stamp_ns)
        return self._prior_of(motion, last_rad)

    def _prior_of(self, motion: RelativeMotion | None, last_rad: float) -> PosePrior | None:
        if motion is None:
            return None
        covariance = motion.covariance + np.diag([last_rad**2] * 3 + [0.0] * 3)
        information = np.asarray(np.linalg.inv(covariance), np.float64)
        return PosePrior(self._usual.last @ motion.first_from_last, information)
