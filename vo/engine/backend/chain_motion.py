"""Motions along chains of keyframes, with the uncertainty of odometry over long distances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.types import Floats, Ints
from vo.engine.backend.graph_problem import GraphProblem
from vo.engine.geometry import sim3


class Drift(NamedTuple):
    """Standard deviations of errors of odometry that the windows' covariances do not contain."""

    step_ratio: float  # random, of the length of each step
    step_rad: float  # random, of each step
    ratio: float  # systematic, the same in all steps, of their lengths
    rotation_ratio: float  # systematic, of their rotations


LARGEST = Drift(0.002, 1e-4, 0.01, 0.005)  # that a true loop may contradict; in mono, the usual one
USUAL = Drift(0.0014, 3e-4, 0.002, 0.001)  # in metres (docs/experiments/loop-weights.md)
# Random, of the logarithm of the scale in mono, for each step, and with an inertial sensor.
_STEP_LOG_SCALE, _INERTIAL_STEP_LOG_SCALE = 0.01, 0.0015
# Steps whose covariance is unknown.
_UNKNOWN_RATIO, _UNKNOWN_RAD = 0.1, 0.02
_UNKNOWN_LOG_SCALE = 0.03  # of two segments that an inertial sensor has joined
# Doubted steps: radians, steps of their own and of the median length, and logarithm of the scale.
_DOUBTED_RAD, _DOUBTED_STEPS, _DOUBTED_LOG_SCALE = 0.25, 1.5, 0.2
FIXED_LOG_SCALE = 1e-6  # standard deviation of a scale that cannot change


class ChainMotions:
    """Relative poses of the keyframes of one chain, and their covariances, in constant time.

    Errors of steps are summed in the frame of the chain: the covariance of a motion is the
    difference of two sums. Systematic errors, equal in all steps, add before they are
    squared.

    Attributes:
        odom_from_cam: (n, 4, 4) similarities of all rows.

    Args:
        odom_from_cam: those.
        noise: (n, 7, 7) covariances of the steps that end in the rows, in their frames and units.
        drift: (n, 7, 7) factors of their systematic errors.
    """

    def __init__(self, odom_from_cam: Floats, noise: Floats, drift: Floats) -> None:
        self.odom_from_cam = odom_from_cam
        self._adjoint = sim3.adjoint(odom_from_cam)
        self._inverse_adjoint = sim3.adjoint(sim3.inverse(odom_from_cam))
        carried = self._adjoint @ noise @ np.swapaxes(self._adjoint, 1, 2)
        self._noise = np.cumsum(carried, axis=0)
        self._drift = np.cumsum(self._adjoint @ drift, axis=0)

    def motion(self, a: Ints | int, b: Ints | int) -> Floats:
        """(..., 4, 4) a_from_b of rows of one chain, in the unit of a."""
        return np.asarray(sim3.inverse(self.odom_from_cam[a]) @ self.odom_from_cam[b])

    def covariance(self, a: Ints | int, b: Ints | int) -> Floats:
        """(..., 7, 7) covariances of `motion`, in the frame and unit of b; 0 if a is b."""
        low, high = np.minimum(a, b), np.maximum(a, b)
        drift = self._drift[b] - self._drift[a]
        carried = self._noise[high] - self._noise[low] + drift @ np.swapaxes(drift, -1, -2)
        to_b = self._inverse_adjoint[b]
        return np.asarray(to_b @ carried @ np.swapaxes(to_b, -1, -2))

    def systematic(self, a: Ints | int, b: Ints | int) -> Floats:
        """(..., 7, 7) factors of the systematic errors of `motion`, in the frame and unit of b."""
        return np.asarray(self._inverse_adjoint[b] @ (self._drift[b] - self._drift[a]))

    def joint(self, a: int, rows: Ints, b: int) -> Floats:
        """(n, 7, 7) covariances of the motions from a to each row with that from a to b.

        Rows lie between a and b. All errors are expressed in the frame of b.
        """
        drift, whole = self._drift[rows] - self._drift[a], self._drift[b] - self._drift[a]
        carried = self._noise[rows] - self._noise[a] + drift @ whole.T
        to_b = self._inverse_adjoint[b]
        return np.asarray(to_b @ carried @ to_b.T)

    def adjoint(self, a: Ints | int, b: Ints | int) -> Floats:
        """(..., 7, 7) adjoint of `motion`."""
        return np.asarray(self._inverse_adjoint[a] @ self._adjoint[b])


def motions_of(problem: GraphProblem, metric_drift: Drift = LARGEST) -> ChainMotions:
    """Motions along the chains of a graph."""
    poses = sim3.similarity(problem.odom_from_cam, problem.scale)
    return ChainMotions(poses, *_step_errors(problem, poses, metric_drift))


def _step_errors(
    problem: GraphProblem, poses: Floats, metric_drift: Drift
) -> tuple[Floats, Floats]:
    """Covariances of the steps (n, 7, 7), and factors (n, 7, 7) of their systematic errors.

    They belong to the step that ends in a row, and are in its frame and unit. A row without a step
    has zeros.
    """
    count = len(poses)
    noise, drift = np.zeros((count, 7, 7)), np.zeros((count, 7, 7))
    moves = np.r_[False, problem.chain[1:] == problem.chain[:-1]] & ~problem.is_rigid
    rows = np.flatnonzero(moves)
    if len(rows) == 0:
        return noise, drift
    steps = sim3.inverse(poses[rows]) @ poses[rows - 1]
    length = np.linalg.norm(steps[:, :3, 3], axis=1)
    cosine = np.clip(0.5 * (np.trace(steps[:, :3, :3], axis1=1, axis2=2) - 1.0), -1.0, 1.0)
    angle = np.arccos(cosine)
    noise[rows, :6, :6] = problem.covariance[rows]
    unknown = ~np.isfinite(noise[rows]).all(axis=(1, 2))
    noise[rows[unknown]] = 0.0
    expected = np.where(problem.is_metric[rows], np.array([metric_drift]).T, np.array([LARGEST]).T)
    ratio = np.where(unknown, _UNKNOWN_RATIO, expected[0])
    radians = np.where(unknown, _UNKNOWN_RAD, expected[1])
    shortest = 1e-6 * max(float(length.max()), 1e-6)
    for axis in range(3):
        noise[rows, axis, axis] += radians**2
        noise[rows, axis + 3, axis + 3] += (ratio * length) ** 2 + shortest**2
        drift[rows, axis, axis] = expected[3] * angle
        drift[rows, axis + 3, axis + 3] = expected[2] * length
    by_sensor = np.where(unknown, _UNKNOWN_LOG_SCALE, _INERTIAL_STEP_LOG_SCALE)
    of_mono = np.where(problem.is_inertial[rows], by_sensor, _STEP_LOG_SCALE)
    doubted = problem.is_doubted[rows]
    of_mono = np.where(doubted, _DOUBTED_LOG_SCALE, of_mono)
    noise[rows, 6, 6] = np.where(problem.is_metric[rows], FIXED_LOG_SCALE, of_mono) ** 2
    wide = _DOUBTED_STEPS * (length[doubted] + median(length))
    for axis in range(3):
        noise[rows[doubted], axis, axis] += _DOUBTED_RAD**2
        noise[rows[doubted], axis + 3, axis + 3] += wide**2
    return noise, drift
