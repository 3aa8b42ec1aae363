"""A path by the information of all images and all samples of an inertial sensor together.

Velocities and biases are eliminated along the chain; what is left are dense normal equations of the
poses, to which the information of the images is added.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats, ImuNoise
from vo.engine.geometry import so3
from vo.engine.inertial.chain_solver import Equations
from vo.engine.inertial.estimation import PARTS, ChainProblem, first_prior
from vo.engine.inertial.keyframe_states import KeyframeStates
from vo.engine.inertial.states import ACCEL_BIAS, POSITION, VELOCITY, WIDTH, States

_ITERATIONS = 3  # from a path that images have adjusted
_POSE, _REST = slice(0, POSITION.stop), slice(VELOCITY.start, ACCEL_BIAS.stop)
_SIZE = _REST.stop - _REST.start
_TOGETHER = 32  # states whose elimination changes the equations at once


class JointPaths:
    """Worlds of a metric path that images and samples have placed, for another path of them.

    Attributes:
        placed: each of them with its states.
    """

    def __init__(self, noise: ImuNoise) -> None:
        self.placed: list[KeyframeStates] = []
        self._noise = noise

    def of(
        self, keyframes: list[int], world_from_cam: Floats, information: Floats
    ) -> tuple[Floats, Floats] | None:
        """As `joint_path`; None where these are not all keyframes of one world, by their ids."""
        for solved in self.placed:
            if [node.keyframe for node in solved.nodes] == keyframes:
                return joint_path(solved, self._noise, world_from_cam, information)
        return None


class _Reduced(NamedTuple):
    """Normal equations of n poses, and what the other states are for a step of these."""

    hessian: Floats  # (6 n, 6 n)
    gradient: Floats  # (6 n,)
    gains: list[tuple[Floats, Floats, Floats]]  # by poses, by the next state, and constant
    log_determinant: float  # of the eliminated states


class _Solution(NamedTuple):
    """Most probable states with one part of the variances of the images."""

    states: States
    covariance: Floats  # (n, 6, 6) of the poses of the camera, relative to the first
    evidence: float  # logarithm of the probability of all measurements, but for a constant


def joint_path(
    solved: KeyframeStates, noise: ImuNoise, world_from_cam: Floats, information: Floats
) -> tuple[Floats, Floats] | None:
    """Poses (n, 4, 4) of a metric path, the first as it was, and covariances relative to it.

    The part of the stated variances of the images is that with the largest evidence, as of motions
    between keyframes (`with_weighed_images`); covariances are those of all of it, as errors of
    landmarks are alike. None where something is not determined.

    Args:
        solved: the same keyframes with their states.
        noise: of the sensor.
        world_from_cam: (n, 4, 4) by images.
        information: (6 n - 6, 6 n - 6) of images on all poses but the first, tangents on the right.
    """
    imu_from_cam = solved.estimate.steps.imu_from_cam
    states = _placed(solved.estimate.states, world_from_cam, imu_from_cam)
    visual = np.zeros(len(world_from_cam) - 1, bool)
    steps = replace(solved.estimate.steps, is_visual=visual)
    problem = ChainProblem(steps, first_prior(states.rows(slice(0, 1)), is_metric=True), noise)
    tried: list[_Solution] = []
    try:
        for part in (1.0, *PARTS):
            start = tried[-1].states if tried else states
            tried.append(_solved(problem, start, world_from_cam, information / part))
    except np.linalg.LinAlgError:
        return None
    best = max(tried, key=lambda each: each.evidence)
    found = _cameras(best.states, imu_from_cam)
    return world_from_cam[0] @ inverse(found[0]) @ found, tried[0].covariance


def _placed(states: States, world_from_cam: Floats, imu_from_cam: Floats) -> States:
    """States on another path, whose first pose is theirs."""
    first = _cameras(states.rows(slice(0, 1)), imu_from_cam)[0]
    pose = first @ inverse(world_from_cam[0]) @ world_from_cam @ inverse(imu_from_cam)
    return states._replace(rotation=pose[:, :3, :3], position=pose[:, :3, 3])


def _cameras(states: States, imu_from_cam: Floats) -> Floats:
    pose = np.tile(np.eye(4), (states.number, 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = states.rotation, states.position
    return np.asarray(pose @ imu_from_cam)


def _solved(
    problem: ChainProblem, states: States, world_from_cam: Floats, information: Floats
) -> _Solution:
    count, imu_from_cam = states.number, problem.steps.imu_from_cam
    expected = inverse(world_from_cam[:1]) @ world_from_cam
    for _ in range(_ITERATIONS):
        reduced = _reduced(problem.normal_equations(states))
        cameras = _cameras(states, imu_from_cam)
        off = inverse(expected) @ inverse(cameras[:1]) @ cameras
        residual = np.concatenate([so3.log(off[:, :3, :3]), off[:, :3, 3]], axis=1)[1:].ravel()
        effect = _effect(states, cameras, imu_from_cam)
        weighed = information @ effect
        hessian = reduced.hessian + effect.T @ weighed
        lower = np.linalg.cholesky(hessian)
        step = -np.linalg.solve(hessian, reduced.gradient + weighed.T @ residual)
        states = states.moved(_with_rest(reduced, step))
        cost = problem.cost + residual @ information @ residual
    determinants = 2.0 * np.log(np.diag(lower)).sum() + reduced.log_determinant
    evidence = 0.5 * (np.linalg.slogdet(information)[1] - determinants - cost)
    spread = effect @ np.linalg.inv(hessian) @ effect.T
    blocks = spread.reshape(count - 1, 6, count - 1, 6)
    own = blocks[np.arange(count - 1), :, np.arange(count - 1)]
    covariance = np.concatenate([np.zeros((1, 6, 6)), 0.5 * (own + np.swapaxes(own, 1, 2))])
    return _Solution(states, covariance, float(evidence))


def _reduced(equations: Equations) -> _Reduced:
    """Eliminate velocities and biases, from the first state to the last."""
    own = equations.before + equations.after
    slope = equations.gradient_before + equations.gradient_after
    count = len(own)
    hessian = np.zeros((count, 6, count, 6))
    rows = np.arange(count)
    hessian[rows, :, rows] = own[:, _POSE, _POSE]
    coupling = equations.coupling[: count - 1]
    hessian[rows[:-1], :, rows[1:]] = coupling[:, _POSE, _POSE]
    hessian[rows[1:], :, rows[:-1]] = np.swapaxes(coupling[:, _POSE, _POSE], 1, 2)
    dense, gradient = hessian.reshape(6 * count, 6 * count), slope[:, _POSE].ravel()
    blocks = np.zeros((count, _SIZE, count, 6))
    blocks[rows, :, rows] = own[:, _REST, _POSE]
    blocks[rows[:-1], :, rows[1:]] = coupling[:, _REST, _POSE]
    blocks[rows[1:], :, rows[:-1]] = np.swapaxes(coupling[:, _POSE, _REST], 1, 2)
    by_pose = blocks.reshape(count, _SIZE, 6 * count)
    rest, constant, gains, log_determinant = own[:, _REST, _REST], slope[:, _REST], [], 0.0
    for k in range(count):
        begin = k - k % _TOGETHER
        end = 6 * min(begin + _TOGETHER + 1, count)  # later poses are not seen yet
        scale = 1.0 / np.sqrt(np.diag(rest[k]))
        scaled = rest[k] * scale[:, None] * scale
        log_determinant += float(np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum())
        known = np.linalg.inv(scaled) * scale[:, None] * scale
        after = coupling[k][_REST, _REST] if k + 1 < count else np.zeros((_SIZE, _SIZE))
        gain = known @ by_pose[k, :, :end], known @ after, known @ constant[k]
        if k + 1 < count:
            by_pose[k + 1, :, :end] -= after.T @ gain[0]
            rest[k + 1] -= after.T @ gain[1]
            constant[k + 1] -= after.T @ gain[2]
        gains.append(gain)
        if k + 1 in (begin + _TOGETHER, count):
            seen = by_pose[begin : k + 1, :, :end].reshape(-1, end)
            dense[:end, :end] -= seen.T @ np.concatenate([each[0] for each in gains[begin:]])
            gradient[:end] -= seen.T @ np.concatenate([each[2] for each in gains[begin:]])
    return _Reduced(dense, gradient, gains, log_determinant)


def _with_rest(reduced: _Reduced, step: Floats) -> Floats:
    """The step (n, WIDTH) of all states for one of the poses."""
    count = len(reduced.gains)
    whole = np.zeros((count, WIDTH))
    whole[:, _POSE] = step.reshape(count, 6)
    following = np.zeros(_SIZE)
    for k in range(count - 1, -1, -1):
        by_pose, by_next, constant = reduced.gains[k]
        following = -(constant + by_pose @ step[: by_pose.shape[1]] + by_next @ following)
        whole[k, _REST] = following
    return whole


def _effect(states: States, cameras: Floats, imu_from_cam: Floats) -> Floats:
    """(6 n - 6, 6 n) of steps of the states on the poses of the camera relative to the first."""
    count = states.number
    own = np.zeros((count, 6, 6))
    own[:, :3, :3], own[:, 3:, 3:] = np.eye(3), np.swapaxes(states.rotation, 1, 2)
    own = adjoint(inverse(imu_from_cam)) @ own
    effect = np.zeros((count - 1, 6, count, 6))
    rows = np.arange(count - 1)
    effect[rows, :, rows + 1] = own[1:]
    effect[:, :, 0] -= adjoint(inverse(cameras[1:]) @ cameras[0]) @ own[0]
    return effect.reshape(6 * count - 6, 6 * count)
