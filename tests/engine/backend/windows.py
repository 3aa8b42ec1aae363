"""Windows of keyframes with known truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse, se3_exp, se3_log, transform_points
from vo.base.types import Floats, Ints, Keypoints
from vo.engine.backend.covariance import propagated
from vo.engine.backend.solution import WindowSolution
from vo.engine.backend.window_problem import WindowProblem

INTRINSICS = Intrinsics(500.0, 500.0, 320.0, 200.0)
BASELINE_M = 0.25
SIGMA_PX, SIGMA_DISPARITY_PX = 0.5, 0.4


@dataclass(frozen=True, eq=False)
class Window:
    """A problem that starts at the truth and has no noise, with the truth beside it."""

    problem: WindowProblem
    world_from_cam: Floats
    points: Floats

    def with_noise(self, seed: int, sigma_px: float = SIGMA_PX) -> Window:
        rng = np.random.default_rng(seed)
        p = self.problem
        xy = p.xy + sigma_px * rng.standard_normal(p.xy.shape)
        disparity = p.disparity + SIGMA_DISPARITY_PX * rng.standard_normal(len(p.disparity))
        return replace(self, problem=replace(p, xy=xy, disparity=disparity))

    def with_guess(self, seed: int = 0, size: float = 1.0) -> Window:
        """Poses that are not fixed, and all points, are moved away from the truth."""
        rng = np.random.default_rng(seed)
        poses = self.world_from_cam.copy()
        for k in np.flatnonzero(~self.problem.fixed):
            xi = size * rng.normal(0, [0.01] * 3 + [0.05] * 3)
            poses[k] = poses[k] @ se3_exp(xi)
        points = self.points * (1 + 0.03 * size * rng.standard_normal((len(self.points), 1)))
        return replace(self, problem=replace(self.problem, world_from_cam=poses, points=points))

    def errors(self, world_from_cam: Floats) -> Floats:
        """(K, 6) tangents xi with truth = estimate @ exp(xi)."""
        pairs = zip(self.world_from_cam, world_from_cam, strict=True)
        return np.stack([se3_log(inverse(found) @ truth) for truth, found in pairs])


def observed(problem: WindowProblem, rows: Ints) -> WindowProblem:
    """The problem with some of its observations, in another order or several times."""
    names = ("keyframe", "point", "xy", "disparity", "sigma_px")
    return replace(problem, **{name: getattr(problem, name)[rows] for name in names})


def blank_keypoints(count: int) -> Keypoints:
    """Keypoints that nothing looks at."""
    zeros = np.zeros(count, np.float32)
    pixels, octave = np.zeros((count, 2), np.float32), np.zeros(count, np.int32)
    return Keypoints(pixels, octave, zeros, zeros, np.zeros((count, 32), np.uint8))


def covariance_given_held(solution: WindowSolution) -> Floats:
    """(K, 6, 6) as if the poses that were held were exact."""
    known = np.zeros_like(solution.information)
    return blocks(propagated(solution.information, solution.held, known))


def blocks(joint: Floats) -> Floats:
    """(K, 6, 6) on the diagonal of (6 K, 6 K)."""
    return np.stack([joint[k : k + 6, k : k + 6] for k in range(0, len(joint), 6)])


def drive(
    keyframes: int = 8, points: int = 200, *, stereo: bool, fixed: int, step_m: float = 0.4
) -> Window:
    """A camera that drives ahead in a slight curve through a cloud of points."""
    rng = np.random.default_rng(7)
    move = np.array([0.004, 0.03, -0.002, 0.2 * step_m, 0.02, step_m])
    poses = np.stack([se3_exp(k * move) for k in range(keyframes)])
    cloud = rng.uniform((-8, -3, 6), (8, 3, 30), (points, 3))
    fx, fy, cx, cy = INTRINSICS
    rows = []
    for k, pose in enumerate(poses):
        in_cam = transform_points(inverse(pose), cloud)
        xy = in_cam[:, :2] / in_cam[:, 2:] * (fx, fy) + (cx, cy)
        seen = (in_cam[:, 2] > 1) & np.all((xy > 0) & (xy < (640, 400)), axis=1)
        disparity = fx * BASELINE_M / in_cam[:, 2]
        rows += [(k, m, *xy[m], disparity[m]) for m in np.flatnonzero(seen)]
    table = np.array(rows)
    often = np.bincount(table[:, 1].astype(int), minlength=points) >= 2
    table = table[often[table[:, 1].astype(int)]]
    number = np.cumsum(often) - 1
    problem = WindowProblem(
        intrinsics=INTRINSICS,
        baseline_m=BASELINE_M if stereo else 0.0,
        sigma_disparity_px=SIGMA_DISPARITY_PX,
        world_from_cam=poses.copy(),
        fixed=np.arange(keyframes) < fixed,
        points=cloud[often].copy(),
        keyframe=table[:, 0].astype(np.int64),
        point=number[table[:, 1].astype(np.int64)],
        xy=table[:, 2:4].copy(),
        disparity=table[:, 4] if stereo else np.full(len(table), np.nan),
        sigma_px=np.full(len(table), SIGMA_PX),
    )
    return Window(problem, poses, cloud[often])
