"""First states from the poses of the visual odometry: biases, gravity, scale and velocities.

Linear least squares give the bias of the gyroscope, then everything else; a least-squares estimate
of all states refines them. Sources: Martinelli, "Closed-form solution of visual-inertial structure
from motion", 2014; Qin, Li and Shen, "VINS-Mono", 2018, sec. V-B; Campos et al. 2020.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, ImuNoise
from vo.engine.geometry import so3
from vo.engine.inertial.estimation import Estimate, KnownBiases, estimate_states, first_prior
from vo.engine.inertial.preintegration import Interval, Preintegrated, preintegrate
from vo.engine.inertial.states import GRAVITY_M_S2, LOG_SCALE, States, Steps

_ACCEL_BIAS_M_S2 = 0.3  # standard deviation before anything is known
_MAX_GRAVITY_ERROR = 0.1  # of the magnitude, in the linear solution
_MAX_GRAVITY_SIGMA = 0.02  # of the magnitude, from which a wrong one is an error
_MIN_SIGMA = 5.0  # of a negative scale that is an error
_MAX_SIGMA_LOG_SCALE = 0.02
_MAX_SIGMA_TILT_RAD = 0.03
_MAX_MISFIT = 3.0
_MAX_ROTATION_RAD = 0.03  # median difference of the rotations by images and by the gyroscope
_MAX_GYRO_BIAS_RAD_S = 0.5
_GYRO_ROUNDS = 4


class NotYet(Enum):
    """Why there are no first states yet."""

    FEW_KEYFRAMES = "too few keyframes with inertial samples between them"
    NO_MOTION = "the motion does not determine the scale yet"
    NO_GRAVITY = "the motion does not determine gravity yet"
    DISAGREEMENT = "images and inertial sensor do not agree"
    WRONG_ROTATION = "rotations by images and by the gyroscope differ"
    WRONG_GRAVITY = (
        "gravity by its accelerometer is not 9.81 m/s² (wrong scale or bias, or it is in a vehicle "
        "that accelerates)"
    )
    OPPOSITE = "its accelerations have the opposite sign of those by images"


WRONG = (
    NotYet.DISAGREEMENT,
    NotYet.WRONG_ROTATION,
    NotYet.WRONG_GRAVITY,
    NotYet.OPPOSITE,
)
"""Reasons that do not go away with more motion."""


@frozen(eq=False)
class Keyframes:
    """Poses of consecutive keyframes of one segment, and the samples between them."""

    world_from_cam: Floats  # (n, 4, 4) in the units and the frame of the visual map
    covariance: Floats  # (n - 1, 6, 6) of the motions from each to the next, as in `Steps`
    intervals: tuple[Interval, ...]  # n - 1
    is_metric: bool  # whether the unit is the metre
    imu_from_cam: Floats  # (4, 4)
    noise: ImuNoise  # of the sensor
    biases: KnownBiases | None = None  # at the first keyframe, None if nothing is known of them

    def steps(self, gyro_bias: Floats, accel_bias: Floats) -> Steps:
        """Measurements between the keyframes, with preintegration at given biases."""
        inertial = tuple(
            preintegrate(interval, gyro_bias, accel_bias, self.noise) for interval in self.intervals
        )
        return Steps(
            np.array([interval.duration_s for interval in self.intervals]),
            inertial,
            inverse(self.world_from_cam[:-1]) @ self.world_from_cam[1:],
            self.covariance,
            np.ones(len(inertial), dtype=bool),
            self.is_metric,
            self.imu_from_cam,
        )


def initial_estimate(keyframes: Keyframes) -> Estimate | NotYet:
    """States at all keyframes, in a world whose z axis points up; or why there are none.

    The world's origin is the first camera; its heading is that of `upright`.
    """
    if len(keyframes.intervals) < 3:
        return NotYet.FEW_KEYFRAMES
    gyro_bias, difference = _gyro_bias(keyframes)
    if difference > _MAX_ROTATION_RAD or np.abs(gyro_bias).max() > _MAX_GYRO_BIAS_RAD_S:
        return NotYet.WRONG_ROTATION
    steps = keyframes.steps(gyro_bias, np.zeros(3))
    inertial = tuple(m for m in steps.inertial if m is not None)
    linear = _linear_states(keyframes, inertial, gyro_bias)
    if isinstance(linear, NotYet):
        return linear
    try:
        first = linear.rows(slice(0, 1))
        prior = first_prior(first, is_metric=keyframes.is_metric, biases=keyframes.biases)
        estimate = estimate_states(linear, steps, prior, keyframes.noise)
    except np.linalg.LinAlgError:
        return NotYet.NO_MOTION
    return _judged(estimate, is_metric=keyframes.is_metric)


def _judged(estimate: Estimate, *, is_metric: bool) -> Estimate | NotYet:
    """The estimate, if it is certain enough."""
    covariance = estimate.covariance[-1]
    if not is_metric and not covariance[LOG_SCALE, LOG_SCALE] < _MAX_SIGMA_LOG_SCALE**2:
        return NotYet.NO_MOTION
    if not tilt_sigma(estimate.states.rotation[-1], covariance) < _MAX_SIGMA_TILT_RAD:
        return NotYet.NO_GRAVITY
    if not estimate.has_converged or estimate.misfit > _MAX_MISFIT:
        return NotYet.DISAGREEMENT
    return estimate


def _why_not(matrix: Floats, scale: float, gravity: Floats) -> NotYet:
    """Whether an impossible solution for scale and gravity is for lack of motion, or wrong."""
    covariance = np.linalg.pinv(matrix.T @ matrix)
    length = float(np.linalg.norm(gravity))
    along = gravity / max(length, 1e-9)
    sigma = float(np.sqrt(along @ covariance[1:4, 1:4] @ along))
    if sigma > _MAX_GRAVITY_SIGMA * GRAVITY_M_S2:
        return NotYet.NO_GRAVITY if scale > 0.0 else NotYet.NO_MOTION
    if scale < -_MIN_SIGMA * float(np.sqrt(covariance[0, 0])):
        return NotYet.OPPOSITE
    if abs(length / GRAVITY_M_S2 - 1.0) < _MAX_GRAVITY_ERROR:
        return NotYet.NO_MOTION
    return NotYet.WRONG_GRAVITY


def tilt_sigma(world_from_imu: Floats, covariance: Floats) -> float:
    """Standard deviation of the direction of gravity in the sensor's frame, radians."""
    in_world = world_from_imu @ covariance[:3, :3] @ world_from_imu.T
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(in_world[:2, :2])[-1])))


def upright(rotation: Floats, gravity: Floats) -> Floats:
    """(3, 3) upright_from_world: z up, x in the direction in which the first camera looks.

    A camera that looks almost straight up or down gives the direction of its image's upper edge.
    `rotation`: (3, 3) world_from_cam of the first camera.
    """
    up = -gravity / np.linalg.norm(gravity)
    forward = rotation[:, 2]
    if abs(float(forward @ up)) > np.cos(np.radians(10.0)):
        forward = -rotation[:, 1]
    x = forward - up * (forward @ up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _gyro_bias(keyframes: Keyframes) -> tuple[Floats, float]:
    """Bias (3,), and the median difference of rotations that it leaves, radians."""
    to_imu = keyframes.imu_from_cam[:3, :3]
    rotation = keyframes.world_from_cam[:, :3, :3] @ to_imu.T
    relative = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    zero = np.zeros(3)
    measured = [preintegrate(i, zero, zero, keyframes.noise) for i in keyframes.intervals]
    jacobian = np.stack([m.jacobian[:3, :3] for m in measured])
    predicted = np.stack([m.rotation for m in measured])
    bias, off = zero, np.zeros((len(measured), 3))
    for _ in range(_GYRO_ROUNDS):
        corrected = predicted @ so3.exp(jacobian @ bias)
        off = so3.log(np.swapaxes(corrected, 1, 2) @ relative)
        size = np.linalg.norm(off, axis=1)
        weight = 1.0 / np.maximum(size, 0.5 * median(size) + 1e-9)  # towards the median
        normal = np.einsum("n,nji,njk->ik", weight, jacobian, jacobian)
        bias = bias + np.linalg.solve(normal, np.einsum("n,nji,nj->i", weight, jacobian, off))
    corrected = predicted @ so3.exp(jacobian @ bias)
    off = so3.log(np.swapaxes(corrected, 1, 2) @ relative)
    return bias, median(np.linalg.norm(off, axis=1))


def _linear_states(
    keyframes: Keyframes, inertial: tuple[Preintegrated, ...], gyro_bias: Floats
) -> States | NotYet:
    """States of all keyframes from linear equations, turned upright.

    Unknown are the scale, gravity, the bias of the accelerometer and all velocities. The equations
    are those of `inertial_residuals` with known rotations.
    """
    count, lever = len(keyframes.world_from_cam), keyframes.imu_from_cam[:3, 3]
    rotation = keyframes.world_from_cam[:, :3, :3] @ keyframes.imu_from_cam[:3, :3].T
    centre = keyframes.world_from_cam[:, :3, 3] - keyframes.world_from_cam[0, :3, 3]
    arm = rotation @ lever
    # Columns: scale, gravity, bias of the accelerometer, velocities.
    rows = 6 * (count - 1)
    matrix, right = np.zeros((rows + 4, 7 + 3 * count)), np.zeros(rows + 4)
    for k, measured in enumerate(inertial):
        duration, first = measured.duration_s, rotation[k]
        sigma = np.sqrt(np.diag(measured.covariance))[3:]
        sigma = np.maximum(sigma, [0.01] * 3 + [0.005] * 3)  # visual noise, roughly
        weight_velocity, weight_position = 1.0 / sigma[:3, None], 1.0 / sigma[3:, None]
        here, there = slice(7 + 3 * k, 10 + 3 * k), slice(10 + 3 * k, 13 + 3 * k)
        row = slice(6 * k, 6 * k + 3)
        matrix[row, there], matrix[row, here] = np.eye(3), -np.eye(3)
        matrix[row, 1:4] = -np.eye(3) * duration
        matrix[row, 4:7] = -first @ measured.jacobian[3:6, 3:]
        right[row] = first @ measured.velocity
        matrix[row] *= weight_velocity
        right[row] *= weight_velocity[:, 0]
        row = slice(6 * k + 3, 6 * k + 6)
        matrix[row, 0] = centre[k + 1] - centre[k]
        matrix[row, here] = -np.eye(3) * duration
        matrix[row, 1:4] = -0.5 * np.eye(3) * duration**2
        matrix[row, 4:7] = -first @ measured.jacobian[6:9, 3:]
        right[row] = first @ measured.position + (arm[k + 1] - arm[k])
        matrix[row] *= weight_position
        right[row] *= weight_position[:, 0]
    sigma, biases = np.full(3, _ACCEL_BIAS_M_S2), keyframes.biases
    if biases is not None:
        sigma = np.sqrt(np.diag(biases.covariance)[3:])
        right[rows : rows + 3] = biases.accel / sigma
    matrix[rows : rows + 3, 4:7] = np.diag(1.0 / sigma)
    if keyframes.is_metric:
        matrix[rows + 3, 0] = right[rows + 3] = 1e6
    solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
    scale, gravity = float(solution[0]), np.asarray(solution[1:4], np.float64)
    error = abs(float(np.linalg.norm(gravity)) / GRAVITY_M_S2 - 1.0)
    if not (error < _MAX_GRAVITY_ERROR and scale > 0.0):
        return _why_not(matrix, scale, gravity)
    turn = upright(keyframes.world_from_cam[0, :3, :3], gravity)
    return States(
        turn @ rotation,
        (scale * centre - arm) @ turn.T,
        solution[7:].reshape(count, 3) @ turn.T,
        np.repeat(gyro_bias[None], count, axis=0),
        np.repeat(solution[None, 4:7], count, axis=0),
        np.full(count, np.log(scale)),
    )
