"""Simulated pose graphs with known truth: laps of a loop, with true and false loops."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.graph_problem import GraphProblem
from vo.engine.geometry import sim3
from vo.engine.places.records import Loop, PlaceKey, RegisteredKeyframes

STEP_SIGMA = np.r_[np.full(3, 5e-4), np.full(3, 0.01)]
LOOP_SIGMA = np.r_[np.full(3, 2e-3), np.full(3, 0.02)]


@dataclass(frozen=True, eq=False)
class Laps:
    """A camera that goes around several times.

    Attributes:
        truth: (n, 4, 4) true poses in the frame of the first.
        problem: noisy odometry, and loops.
        is_true: (L,) loops.
    """

    truth: Floats
    problem: GraphProblem
    is_true: Bools

    def error_m(self, registered: RegisteredKeyframes) -> float:
        """RMS position error; the first pose is given."""
        apart = registered.world_from_cam[:, :3, 3] - self.truth[:, :3, 3]
        return float(np.sqrt((apart**2).sum(axis=1).mean()))

    def odometry_error_m(self) -> float:
        """The same of odometry."""
        apart = self.problem.odom_from_cam[:, :3, 3] - self.truth[:, :3, 3]
        return float(np.sqrt((apart**2).sum(axis=1).mean()))


def laps(
    seed: int,
    *,
    keyframes: int = 300,
    per_lap: int = 100,
    loops: int = 30,
    false_ratio: float = 0.0,
    groups: int = 0,
    noise: float = 1.0,
    scale_sigma: float = 0.0,
) -> Laps:
    """Laps with loops between them.

    Args:
        seed: of all random numbers.
        keyframes: number of poses, 1 m apart.
        per_lap: poses of a lap.
        loops: number of loops.
        false_ratio: ratio of loops with arbitrary relations between arbitrary keyframes.
        groups: false loops come in so many groups that agree within themselves, as if a place
            had a copy; 0 for independent ones.
        noise: factor on all standard deviations.
        scale_sigma: in mono, standard deviation of the logarithm of the scale of a step.
    """
    rng = np.random.default_rng(seed)
    turn = np.zeros(7)
    turn[1], turn[5] = 2.0 * np.pi / per_lap, 1.0
    rise = np.zeros(7)
    truth = [np.eye(4)]
    for n in range(keyframes - 1):
        rise[0] = 0.01 * np.sin(0.13 * n)
        truth.append(truth[-1] @ sim3.retract(turn + rise))
    poses = np.stack(truth)
    steps = sim3.inverse(poses[:-1]) @ poses[1:]
    sigma = noise * np.r_[STEP_SIGMA, scale_sigma]
    steps = steps @ sim3.retract(sigma * rng.normal(size=(keyframes - 1, 7)))
    odom = [np.eye(4)]
    for step in steps:
        odom.append(odom[-1] @ step)
    odometry = np.stack(odom)
    scale = sim3.scale_of(odometry)
    count = round(loops * false_ratio)
    metric = scale_sigma == 0.0
    true = _true_loops(rng, poses, scale, per_lap, loops - count, noise, metric)
    false = _false_loops(rng, keyframes, count, groups, steps, metric)
    problem = GraphProblem(
        keys=np.stack([np.zeros(keyframes, np.int64), np.arange(keyframes)], axis=1),
        chain=np.zeros(keyframes, np.int64),
        is_rigid=np.zeros(keyframes, dtype=bool),
        is_metric=np.full(keyframes, metric),
        is_inertial=np.zeros(keyframes, dtype=bool),
        odom_from_cam=_unscaled_path(steps, scale),
        scale=np.ones(keyframes),
        covariance=np.tile(np.diag(np.maximum(sigma[:6], 1e-9) ** 2), (keyframes, 1, 1)),
        is_doubted=np.zeros(keyframes, dtype=bool),
        loops=(*true, *false),
    )
    return Laps(poses, problem, np.arange(loops) < len(true))


def _unscaled_path(steps: Floats, scale: Floats) -> Floats:
    """Poses as odometry with a drifting scale reports them: rigid, in its own unit."""
    poses = [np.eye(4)]
    for step, before in zip(steps, scale, strict=False):
        rigid = sim3.rigid_part(step)
        rigid[:3, 3] = step[:3, 3] * before
        poses.append(poses[-1] @ rigid)
    return np.stack(poses)


def _loop(earlier: int, later: int, relation: Floats, sigma: Floats, metric: bool) -> Loop:
    covariance = np.diag(np.r_[sigma, 0.0 if metric else 0.01] ** 2)
    return Loop(
        PlaceKey(0, earlier),
        PlaceKey(0, later),
        sim3.rigid_part(relation),
        1.0 if metric else float(sim3.scale_of(relation)),
        covariance,
        60,
    )


def _true_loops(
    rng: np.random.Generator,
    poses: Floats,
    scale: Floats,
    per_lap: int,
    count: int,
    noise: float,
    metric: bool,
) -> list[Loop]:
    loops = []
    for _ in range(count):
        later = int(rng.integers(per_lap, len(poses)))
        lap = int(rng.integers(1, later // per_lap + 1))
        earlier = min(max(later - lap * per_lap + int(rng.integers(-1, 2)), 0), later - 1)
        error = noise * np.r_[LOOP_SIGMA, 0.0] * rng.normal(size=7)
        # Odometry measures a camera's surroundings in a unit of its own.
        relation = sim3.inverse(poses[earlier]) @ poses[later] @ sim3.retract(error)
        relation = sim3.similarity(relation, 1.0)
        relation[:3, 3] *= scale[earlier]
        relation[:3, :3] *= scale[earlier] / scale[later]
        loops.append(_loop(earlier, later, relation, LOOP_SIGMA, metric))
    return loops


def _false_loops(
    rng: np.random.Generator,
    keyframes: int,
    count: int,
    groups: int,
    steps: Floats,
    metric: bool,
) -> list[Loop]:
    odom = [np.eye(4)]
    for step in steps:
        odom.append(odom[-1] @ sim3.rigid_part(step))
    loops: list[Loop] = []
    firsts: list[tuple[int, int, Floats]] = []
    for n in range(count):
        if groups == 0 or n < groups:
            earlier = int(rng.integers(0, keyframes - 40))
            later = int(rng.integers(earlier + 30, keyframes - 8))
            spread = np.r_[np.full(3, 0.1), np.full(3, 0.5), 0.0]
            relation = sim3.retract(spread * rng.normal(size=7))
            firsts.append((earlier, later, relation))
        else:
            first, then, at = firsts[n % groups]
            shift = 1 + n // groups % 7
            earlier, later = first + shift, then + shift
            before = sim3.inverse(odom[earlier]) @ odom[first]
            relation = before @ at @ sim3.inverse(odom[then]) @ odom[later]
        loops.append(_loop(earlier, later, relation, LOOP_SIGMA, metric))
    return loops


def believed(registered: RegisteredKeyframes, problem: GraphProblem) -> Bools:
    """(L,) loops that were not rejected."""
    rejected = {id(loop) for loop in registered.rejected}
    return np.array([id(loop) not in rejected for loop in problem.loops], dtype=bool)


def with_loops(problem: GraphProblem, loops: tuple[Loop, ...]) -> GraphProblem:
    """The same graph with other loops."""
    return replace(problem, loops=loops)


def with_wrong_motion(
    problem: GraphProblem, at: int, motion: Floats, *, is_doubted: bool = True
) -> GraphProblem:
    """The same graph, with odometry that is wrong by a motion (4, 4) before row `at`."""
    odom, doubted = problem.odom_from_cam.copy(), problem.is_doubted.copy()
    odom[at:] = odom[at] @ motion @ sim3.inverse(odom[at]) @ odom[at:]
    doubted[at] = is_doubted
    return replace(problem, odom_from_cam=odom, is_doubted=doubted)


def cut(problem: GraphProblem, at: int) -> GraphProblem:
    """The same graph with a loss of the camera before row `at`: a new segment begins there."""
    chain: Ints = np.arange(len(problem.keys)) // at
    odom = problem.odom_from_cam.copy()
    odom[at:] = sim3.inverse(odom[at]) @ odom[at:]
    return replace(problem, chain=np.minimum(chain, 1), odom_from_cam=odom)


def to_first_lap(case: Laps, per_lap: int = 100) -> Laps:
    """The laps with their loops to keyframes of the first one only."""
    chosen = np.array([loop.earlier.keyframe < per_lap for loop in case.problem.loops])
    loops = tuple(loop for loop, is_in in zip(case.problem.loops, chosen, strict=True) if is_in)
    return replace(case, problem=with_loops(case.problem, loops), is_true=case.is_true[chosen])


def with_drift(case: Laps, radians: float) -> Laps:
    """The laps with odometry that turns by an angle too much with each step."""
    odom = case.problem.odom_from_cam
    steps, more = sim3.inverse(odom[:-1]) @ odom[1:], np.zeros(7)
    more[1] = radians
    path = [odom[0]]
    for step in steps @ sim3.retract(more):
        path.append(path[-1] @ step)
    return replace(case, problem=replace(case.problem, odom_from_cam=np.stack(path)))


def with_copy(case: Laps, at: int, shift_m: float, count: int = 12) -> Laps:
    """Every second keyframe from `at` on has a loop to the lap before as seen from a copy of it."""
    rng, shift, truth, loops = np.random.default_rng(at), np.eye(4), case.truth, []
    shift[2, 3] = shift_m
    for later in range(at, at + 2 * count, 2):
        first = truth[later - 100]
        noise = sim3.retract(np.r_[LOOP_SIGMA, 0.0] * rng.normal(size=7))
        relation = sim3.inverse(first) @ shift @ truth[later] @ noise
        metric = bool(case.problem.is_metric.all())
        loops.append(_loop(later - 100, later, relation, LOOP_SIGMA, metric))
    problem = with_loops(case.problem, (*case.problem.loops, *loops))
    return replace(case, problem=problem, is_true=np.r_[case.is_true, np.zeros(count, dtype=bool)])
