"""Motion of the camera between two times by the inertial samples and what is known before them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse, make_transform, skew
from vo.base.types import Floats, ImuNoise
from vo.engine.inertial.preintegration import Preintegrated, preintegrate, rotation_of
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import (
    ACCEL_BIAS,
    GRAVITY_M_S2,
    GYRO_BIAS,
    LOG_SCALE,
    ROTATION,
    VELOCITY,
    States,
)
from vo.engine.inertial.turning import TurnLog

_MAX_SHARE = 0.99  # of the information on a motion that an inertial one can have
_MAX_S = 3.0  # since the keyframe whose motion is known, and again of what is predicted
# Columns of the errors of a known motion.
_V, _G, _BIASES, _SCALE = slice(0, 3), slice(3, 6), slice(6, 12), 12


class KnownMotion(NamedTuple):
    """What is known of the motion at a time, in the frame of the sensor."""

    stamp_ns: int  # the time
    velocity: Floats  # (3,) m/s
    gravity: Floats  # (3,) m/s², downwards
    gyro_bias: Floats  # (3,) rad/s
    accel_bias: Floats  # (3,) m/s²
    scale: float  # metres of one unit of the local map
    covariance: Floats  # (13, 13) of velocity, gravity, biases and the logarithm of the scale


class Gap(NamedTuple):
    """Frames that were lost before one that was tracked."""

    first_ns: int  # time of the tracked frame before them
    last_ns: int  # time of the tracked frame after them
    known: KnownMotion  # motion before them


class RelativeMotion(NamedTuple):
    """Motion of the rectified camera from one time to another."""

    first_from_last: Floats  # (4, 4) in units of the local map
    covariance: Floats  # (6, 6) tangent on the right, rotation first


def known_motion(stamp_ns: int, states: States, covariance: Floats) -> KnownMotion:
    """What a state (1) with its covariance (WIDTH, WIDTH) says."""
    to_imu = states.rotation[0].T
    velocity = to_imu @ states.velocity[0]
    gravity = to_imu @ np.array([0.0, 0.0, -GRAVITY_M_S2])
    by_state = np.zeros((13, len(covariance)))
    by_state[_V, VELOCITY], by_state[_V, ROTATION] = to_imu, skew(velocity)
    by_state[_G, ROTATION] = skew(gravity)
    by_state[_BIASES, GYRO_BIAS.start : ACCEL_BIAS.stop] = np.eye(6)
    by_state[_SCALE, LOG_SCALE] = 1.0
    return KnownMotion(
        stamp_ns,
        velocity,
        gravity,
        states.gyro_bias[0],
        states.accel_bias[0],
        float(np.exp(states.log_scale[0])),
        by_state @ covariance @ by_state.T,
    )


class InertialPredictor:
    """Predicts motions of the rectified camera while its images show nothing.

    Attributes:
        known: at the newest keyframe of the local map, None while it is unknown.
        gyro_bias: (3,) the newest one that was known, None before.
        noise: of the sensor.
        imu_from_cam: (4, 4) of the rectified camera.
        turns: rotations between images that make no map yet.
        in_windows: motions that are factors of the windows, by the ids of both keyframes; None
            where the motion was unknown.
    """

    def __init__(self, reader: SampleReader, noise: ImuNoise, imu_from_cam: Floats) -> None:
        self.known: KnownMotion | None = None
        self.gyro_bias: Floats | None = None
        self.noise, self.imu_from_cam = noise, imu_from_cam
        self.turns = TurnLog()
        self.in_windows: dict[tuple[int, int], RelativeMotion | None] = {}
        self._reader = reader
        self._apart: InertialPredictor | None = None

    def ahead(self, first_ns: int, last_ns: int) -> RelativeMotion | None:
        """Motion after the known one by a reader of its own: no later result depends on it."""
        if self._apart is None:
            reader = SampleReader(self._reader.sensor)
            self._apart = InertialPredictor(reader, self.noise, self.imu_from_cam)
        self._apart._reader.time_offset_s = self._reader.time_offset_s
        return self._apart.motion(self.known, first_ns, last_ns)

    def turned(self, first_ns: int, last_ns: int) -> Floats | None:
        """(3, 3) first_from_last of the camera by the gyroscope; None without bias or samples."""
        bias, interval = self.gyro_bias, self._reader.between(first_ns, last_ns)
        if bias is None or interval is None:
            return None
        to_imu = self.imu_from_cam[:3, :3]
        return np.asarray(to_imu.T @ rotation_of(interval, bias) @ to_imu)

    def has_samples(self, first_ns: int, last_ns: int) -> bool:
        """Whether the motion is known, and the samples between two times."""
        return self.known is not None and self._reader.between(first_ns, last_ns) is not None

    def motion(
        self, known: KnownMotion | None, first_ns: int, last_ns: int
    ) -> RelativeMotion | None:
        """Motion between two times after a known one; None without samples, or for too long."""
        if known is None or not known.stamp_ns <= first_ns < last_ns:
            return None
        if max(first_ns - known.stamp_ns, last_ns - first_ns) > _MAX_S * 1e9:
            return None
        if first_ns > known.stamp_ns:
            until = self._preintegrated(known, known.stamp_ns, first_ns)
            if until is None:
                return None
            known = _after(known, until, first_ns)
        step = self._preintegrated(known, first_ns, last_ns)
        return None if step is None else self._of_camera(known, step)

    def _preintegrated(
        self, known: KnownMotion, first_ns: int, last_ns: int
    ) -> Preintegrated | None:
        interval = self._reader.between(first_ns, last_ns)
        if interval is None:
            return None
        return preintegrate(interval, known.gyro_bias, known.accel_bias, self.noise)

    def _of_camera(self, known: KnownMotion, step: Preintegrated) -> RelativeMotion:
        duration = step.duration_s
        way = known.velocity * duration + 0.5 * known.gravity * duration**2 + step.position
        imu_motion = make_transform(step.rotation, way)
        by_known = np.zeros((6, 13))
        by_known[:3, _BIASES] = step.jacobian[:3]
        by_known[3:, _V] = duration * np.eye(3)
        by_known[3:, _G] = 0.5 * duration**2 * np.eye(3)
        by_known[3:, _BIASES] = step.jacobian[6:9]
        chosen = np.r_[0:3, 6:9]
        covariance = by_known @ known.covariance @ by_known.T + step.covariance[chosen][:, chosen]
        # From the axes at the start to those at the end, then to the camera.
        turn = np.eye(6)
        turn[3:, 3:] = step.rotation.T
        to_cam = adjoint(inverse(self.imu_from_cam)) @ turn
        motion = inverse(self.imu_from_cam) @ imu_motion @ self.imu_from_cam
        motion[:3, 3] /= known.scale
        unit = np.array([1.0] * 3 + [1.0 / known.scale] * 3)
        covariance = (to_cam @ covariance @ to_cam.T) * unit * unit[:, None]
        of_scale = np.concatenate([np.zeros(3), motion[:3, :3].T @ motion[:3, 3]])
        covariance += known.covariance[_SCALE, _SCALE] * np.outer(of_scale, of_scale)
        return RelativeMotion(motion, 0.5 * (covariance + covariance.T))


def without_inertial(covariance: Floats, inertial: Floats) -> Floats:
    """Covariance (6, 6) of a motion by images alone, of one that an inertial motion is a part of.

    The information of independent measurements adds, so it is subtracted here. Along directions
    in which images have less than 1 % of the information they keep 1 %. The motion itself cannot
    be taken apart in this way: an error of either covariance would move it by many times its own.
    """
    root = np.linalg.cholesky(covariance)
    shares = root.T @ np.linalg.solve(inertial, root)
    share, axes = np.linalg.eigh(0.5 * (shares + shares.T))
    axes = root @ axes
    return np.asarray(axes / (1.0 - share.clip(0.0, _MAX_SHARE)) @ axes.T)


def _after(known: KnownMotion, step: Preintegrated, stamp_ns: int) -> KnownMotion:
    """What is known after some samples; the error of their rotation is left out."""
    back, duration = step.rotation.T, step.duration_s
    change = np.eye(13)
    change[_V, _V] = change[_G, _G] = back
    change[_V, _G] = duration * back
    change[_V, _BIASES] = back @ step.jacobian[3:6]
    covariance = change @ known.covariance @ change.T
    covariance[_V, _V] += back @ step.covariance[3:6, 3:6] @ back.T
    return known._replace(
        stamp_ns=stamp_ns,
        velocity=back @ (known.velocity + known.gravity * duration + step.velocity),
        gravity=back @ known.gravity,
        covariance=covariance,
    )
