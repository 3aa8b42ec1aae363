"""Factors of a window beside the observations: relative poses, and velocities as further states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from windows import Window, blank_keypoints, drive

from vo.base.config import SmoothingConfig
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import adjoint, inverse
from vo.base.stopwatch import Stopwatch
from vo.base.types import Floats
from vo.engine.backend.optimizer import DeferredOptimizer, ThreadOptimizer
from vo.engine.backend.sliding_window import SlidingWindow
from vo.engine.backend.solution import solve
from vo.engine.backend.window_problem import WindowFactor
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.mapping.keyframe import FrameId, Keyframe, NewObservations
from vo.engine.mapping.local_map import LocalMap

PRECISE = SmoothingConfig(iterations=40, relative_error_tolerance=1e-12)
PERIOD_S = 0.1


@dataclass(frozen=True, eq=False)
class RelativePose:
    """A measured pose of one keyframe in another."""

    first: int
    second: int
    second_in_first: Floats
    sigma: float

    def add_to(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        pose_key: Callable[[int], int],
    ) -> None:
        noise = gtsam.noiseModel.Isotropic.Sigma(6, self.sigma)
        keys = pose_key(self.first), pose_key(self.second)
        pose = gtsam.Pose3(self.second_in_first)
        graph.add(gtsam.BetweenFactorPose3(*keys, pose, noise))


@dataclass(frozen=True)
class Velocity:
    """The velocity between two keyframes, a state of its own."""

    first: int
    sigma: float = 0.01

    def add_to(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        pose_key: Callable[[int], int],
    ) -> None:
        velocity = velocity_key(self.first)
        values.insert(velocity, np.zeros(3))
        keys = [pose_key(self.first), pose_key(self.first + 1), velocity]

        def error(
            _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats] | None
        ) -> Floats:
            start, end = values.atPose3(keys[0]), values.atPose3(keys[1])
            if jacobians is not None:
                nothing = np.zeros((3, 3))
                jacobians[0] = np.hstack([nothing, -start.rotation().matrix()])
                jacobians[1] = np.hstack([nothing, end.rotation().matrix()])
                jacobians[2] = -PERIOD_S * np.eye(3)
            step = end.translation() - start.translation()
            return np.asarray(step - PERIOD_S * values.atVector(velocity))

        graph.add(gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(3, self.sigma), keys, error))


def velocity_key(number: int) -> int:
    return int(gtsam.symbol("v", number))


def relative_pose(window: Window, first: int, second: int, sigma: float) -> RelativePose:
    poses = window.world_from_cam
    return RelativePose(first, second, inverse(poses[first]) @ poses[second], sigma)


def scaled(window: Window, scale: float) -> Window:
    """A guess with everything farther from the first pose, which observations do not notice."""
    poses = window.world_from_cam.copy()
    poses[:, :3, 3] *= scale
    problem = replace(window.problem, world_from_cam=poses, points=scale * window.points)
    return replace(window, problem=problem)


def with_factors(window: Window, *factors: WindowFactor) -> Window:
    return replace(window, problem=replace(window.problem, factors=factors))


def test_a_relative_pose_determines_the_scale_of_one_camera() -> None:
    window = scaled(drive(stereo=False, fixed=1), 1.05)
    without = solve(window.problem, PRECISE)
    assert np.abs(window.errors(without.world_from_cam)[-1, 3:]).max() > 0.1
    factor = relative_pose(window, 0, 7, sigma=1e-4)
    solution = solve(with_factors(window, factor).problem, PRECISE)
    assert solution.converged
    assert np.abs(window.errors(solution.world_from_cam)).max() < 1e-3
    np.testing.assert_allclose(solution.points, window.points, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("stereo", [True, False])
def test_the_information_on_poses_grows_by_that_of_the_factor(stereo: bool) -> None:
    window = drive(stereo=stereo, fixed=2)
    sigma, first, second = 0.01, 1, 5  # a held and a free pose
    poses = window.world_from_cam
    factor = relative_pose(window, first, second, sigma)
    more = solve(with_factors(window, factor).problem, PRECISE).information
    gain = more - solve(window.problem, PRECISE).information
    jacobian = np.zeros((6, 6 * len(poses)))
    jacobian[:, 6 * first : 6 * first + 6] = -adjoint(inverse(poses[second]) @ poses[first])
    jacobian[:, 6 * second : 6 * second + 6] = np.eye(6)
    expected = jacobian.T @ jacobian / sigma**2
    np.testing.assert_allclose(gain, expected, atol=1e-4 * np.abs(expected).max())


def test_further_states_are_estimated_and_add_no_information_by_themselves() -> None:
    window = drive(stereo=True, fixed=2)
    factors = [Velocity(k) for k in range(7)]
    solution = solve(with_factors(window, *factors).problem, PRECISE)
    steps = np.diff(window.world_from_cam[:, :3, 3], axis=0)
    assert set(solution.states) == {velocity_key(k) for k in range(7)}
    for k, step in enumerate(steps):
        found = solution.states[velocity_key(k)]
        np.testing.assert_allclose(found, step / PERIOD_S, atol=1e-4)
    plain = solve(window.problem, PRECISE)
    atol = 1e-5 * np.abs(plain.information).max()
    np.testing.assert_allclose(solution.information, plain.information, atol=atol)


def test_a_window_without_further_factors_has_no_further_states() -> None:
    assert solve(drive(stereo=True, fixed=2).problem, PRECISE).states == {}


def test_factors_give_the_same_bits_in_another_thread() -> None:
    window = drive(stereo=True, fixed=2).with_noise(1).with_guess()
    factors = [relative_pose(window, 1, 4, 0.01), *(Velocity(k) for k in range(7))]
    problem = with_factors(window, *factors).problem
    here = DeferredOptimizer(PRECISE)
    here.submit(problem)
    expected = here.result()
    optimizer = ThreadOptimizer(PRECISE)
    try:
        optimizer.submit(problem)
        found = optimizer.result()
    finally:
        optimizer.close()
    assert found.converged
    for name in ("world_from_cam", "points", "information"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert set(found.states) == set(expected.states) == {velocity_key(k) for k in range(7)}
    for key, state in expected.states.items():
        np.testing.assert_array_equal(found.states[key], state)


class Velocities:
    """A factor source that keeps the states that it receives."""

    def __init__(self) -> None:
        self.received: list[tuple[list[int], dict[int, Floats]]] = []

    def factors(self, keyframes: Sequence[Keyframe]) -> Sequence[WindowFactor]:
        return [Velocity(k) for k in range(len(keyframes) - 1)]

    def update(self, keyframes: Sequence[Keyframe], states: dict[int, Floats]) -> None:
        self.received.append(([k.id for k in keyframes], states))


def test_a_factor_source_gives_factors_and_receives_states() -> None:
    window, source = drive(keyframes=5, stereo=True, fixed=1), Velocities()
    local_map = _map_of(window)
    sliding = SlidingWindow(
        local_map, DeferredOptimizer(PRECISE), 0.4, PRECISE, Stopwatch(), [source]
    )
    sliding.submit(calibration_weight=0)
    assert sliding.apply() is not None
    ((ids, states),) = source.received
    assert ids == [0, 1, 2, 3, 4]
    steps = np.diff(window.world_from_cam[:, :3, 3], axis=0)
    found = np.stack([states[velocity_key(k)] for k in range(4)])
    np.testing.assert_allclose(found, steps / PERIOD_S, atol=1e-4)


def _map_of(window: Window) -> LocalMap:
    """A local map with the keyframes, landmarks and observations of a window."""
    problem, count = window.problem, len(window.points)
    rig = RectifiedRig(640, 400, *problem.intrinsics, problem.baseline_m, np.eye(4))
    layout = DescriptorFormat(32, np.dtype(np.uint8))
    local_map = LocalMap(rig, len(window.world_from_cam), layout)
    free, image = np.ones(count, dtype=bool), np.zeros((400, 640), np.uint8)
    for k, pose in enumerate(window.world_from_cam):
        local_map.add_keyframe(FrameId(k, k, 0), image, pose, blank_keypoints(count), free)
    first = local_map.keyframes[0]
    first.covariance = np.zeros((6, 6))
    local_map.add_landmarks(window.points, first, np.arange(count), first)
    for k, keyframe in enumerate(local_map.keyframes):
        seen = np.flatnonzero(problem.keyframe == k)
        xy = problem.xy[seen]
        keyframe.add_observations(
            NewObservations(
                problem.point[seen], xy, xy, problem.disparity[seen], problem.sigma_px[seen]
            )
        )
    return local_map
