"""Normalised estimation errors squared (NEES) of keyframes and of steps between them.

NEES = xi^T C^-1 xi with true = estimate exp(xi), 6 degrees of freedom: its mean is 6 if C is right.
Poses are relative to the first keyframe of their segment, where estimate and truth are aligned; in
mono the unit of length is the one at which the first keyframes have their true distances from the
first. Steps between keyframes k apart share few errors if k is large; their number divided by k is
taken as the number of independent ones in the 95 % interval.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import parser_of
from scipy.stats import chi2

from vo.base.config import Config, load_config
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import adjoint, inverse, se3_log
from vo.base.types import Floats, Ints, KeyframePose, Mode, Trajectory
from vo.engine.backend.covariance import propagated
from vo.engine.backend.sliding_window import SlidingWindow, Window
from vo.engine.backend.solution import WindowSolution
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.odometry import Odometry
from vo.outputs.evaluation.association import associate
from vo.recordings.sources.registry import open_source

STEPS = (1, 5, 20)
MIN_KEYFRAMES = 10  # shorter segments are skipped
SCALE_KEYFRAMES = 7  # their distances from the first define the unit of length in mono
HEADING = """\
| recording | mode | keyframes | poses | steps 1 | steps 5 | steps 20 |
| --- | --- | ---: | ---: | ---: | ---: | ---: |"""


class Pair(NamedTuple):
    """Error of a relative pose, and its estimated covariance."""

    xi: Floats
    covariance: Floats

    @property
    def nees(self) -> float:
        """xi^T C^-1 xi."""
        return float(self.xi @ np.linalg.solve(self.covariance, self.xi))


class JointCovariance:
    """Joint covariance of the newest keyframes, those that left the window included."""

    def __init__(self, memory: int, cam0_from_rectified: Floats) -> None:
        self._memory = memory
        self._ids: list[int] = []
        self._cam0_from_rectified = adjoint(cam0_from_rectified)
        self._blocks: dict[tuple[int, int], Floats] = {}

    def record(self, window: Window, solution: WindowSolution) -> None:
        """Record the covariances of a solution that is applied."""
        if solution.converged:
            self._add([keyframe.id for keyframe in window.keyframes], solution)

    def block(self, row: int, column: int) -> Floats | None:
        """(6, 6) covariance of two keyframes in their cam0 frames, None if unknown."""
        block = self._blocks.get((max(row, column), min(row, column)))
        if block is None or not np.isfinite(block).all():
            return None
        turn = self._cam0_from_rectified
        return np.asarray(turn @ (block if row >= column else block.T) @ turn.T)

    def _add(self, ids: list[int], solution: WindowSolution) -> None:
        for new in ids[:1] if ids[0] not in self._ids else []:
            self._blocks[new, new] = np.zeros((6, 6))  # the first keyframe of a segment
            self._ids = []
        older = [k for k in self._ids if k < ids[0]][-self._memory :]
        every, extra = older + ids, len(older)
        known = self._matrix(every)
        information = np.zeros_like(known)
        information[6 * extra :, 6 * extra :] = solution.information
        fixed = np.concatenate([np.ones(extra, dtype=bool), solution.held])
        joint = propagated(information, fixed, known)
        for a, row in enumerate(every):
            for b, column in enumerate(every[: a + 1]):
                self._blocks[row, column] = joint[6 * a : 6 * a + 6, 6 * b : 6 * b + 6].copy()
        self._ids = older + ids

    def _matrix(self, ids: list[int]) -> Floats:
        """(6 N, 6 N) covariance of these keyframes, NaN where unknown."""
        known = np.full((6 * len(ids), 6 * len(ids)), np.nan)
        for a, row in enumerate(ids):
            for b, column in enumerate(ids[: a + 1]):
                block = self._blocks.get((row, column), np.full((6, 6), np.nan))
                known[6 * a : 6 * a + 6, 6 * b : 6 * b + 6] = block
                known[6 * b : 6 * b + 6, 6 * a : 6 * a + 6] = block.T
        return known


@contextmanager
def recorded_solutions(joint: JointCovariance) -> Iterator[None]:
    """Record the solution of every window that is applied meanwhile."""
    apply_solution = SlidingWindow.apply_solution

    def recording(self: SlidingWindow, window: Window, solution: WindowSolution) -> list[Keyframe]:
        moved = apply_solution(self, window, solution)
        joint.record(window, solution)
        return moved

    SlidingWindow.apply_solution = recording  # type: ignore[method-assign]
    try:
        yield
    finally:
        SlidingWindow.apply_solution = apply_solution  # type: ignore[method-assign]


def pairs(
    keyframes: list[KeyframePose], ids: Ints, true: Floats, joint: JointCovariance, mono: bool
) -> dict[int, list[Pair]]:
    """Errors and covariances of one segment by step; step 0: relative to the first keyframe."""
    estimated = np.stack([k.world_from_cam0 for k in keyframes])
    estimated, true = inverse(estimated[0]) @ estimated, inverse(true[0]) @ true
    scale = _scale(estimated, true) if mono else 1.0
    estimated[:, :3, 3] *= scale
    size = np.r_[np.ones(3), np.full(3, scale)]
    unit = size[:, None] * size
    poses = []
    for k, keyframe in enumerate(keyframes[1:], start=1):
        if keyframe.covariance is not None:
            xi = se3_log(inverse(estimated[k]) @ true[k])
            poses.append(Pair(xi, unit * keyframe.covariance))
    steps = {step: _steps(step, ids, estimated, true, joint, unit) for step in STEPS}
    return {0: poses, **steps}


def _scale(estimated: Floats, true: Floats) -> float:
    """Least-squares scale of the first keyframes' distances from the first."""
    near, truly = estimated[1:SCALE_KEYFRAMES, :3, 3], true[1:SCALE_KEYFRAMES, :3, 3]
    return float((near * truly).sum() / (near**2).sum())


def _steps(
    step: int, ids: Ints, estimated: Floats, true: Floats, joint: JointCovariance, unit: Floats
) -> list[Pair]:
    """Errors and covariances of the steps between keyframes `step` apart."""
    found = []
    for i in range(len(ids) - step):
        j = i + step
        first, second = joint.block(ids[i], ids[i]), joint.block(ids[j], ids[j])
        shared = joint.block(ids[i], ids[j])
        if first is None or second is None or shared is None:
            continue
        between = inverse(estimated[i]) @ estimated[j]
        # true_i = estimated_i exp(a), true_j = estimated_j exp(b): xi = b - Ad(between^-1) a.
        xi = se3_log(inverse(between) @ inverse(true[i]) @ true[j])
        carry = adjoint(inverse(between))
        cross = carry @ (unit * shared)
        covariance = carry @ (unit * first) @ carry.T + unit * second - cross - cross.T
        found.append(Pair(xi, covariance))
    return found


def measure(folder: Path, mode: Mode, config: Config) -> tuple[int, dict[int, list[Pair]]]:
    """Number of keyframes of one recording, and its errors and covariances by step."""
    source = open_source(folder, mode=mode)
    if source.ground_truth is None:
        raise SystemExit(f"error: {folder} has no ground truth")
    joint = JointCovariance(max(STEPS), rectified_rig(source.rig).cam0_from_rectified)
    with recorded_solutions(joint), closing(Odometry(source.rig, config)) as odometry:
        for _ in odometry.track_all(source.frames()):
            pass
        odometry.finish()
        keyframes = odometry.trajectory.keyframes()
    result: dict[int, list[Pair]] = {step: [] for step in (0, *STEPS)}
    for segment in sorted({k.segment for k in keyframes}):
        rows = [i for i, k in enumerate(keyframes) if k.segment == segment]
        stamps = np.array([keyframes[i].stamp_ns for i in rows])
        poses = np.stack([keyframes[i].world_from_cam0 for i in rows])
        matched = associate(Trajectory(stamps, poses), source.ground_truth, interpolated=True)
        there = np.isin(stamps, matched.stamps_ns)
        ids = np.array(rows)[there]  # keyframes are numbered from 0
        if len(ids) < MIN_KEYFRAMES:
            continue
        mine = pairs([keyframes[i] for i in ids], ids, matched.reference, joint, mode == "mono")
        for step, more in mine.items():
            result[step] += more
    return len(keyframes), result


def cell(found: list[Pair], step: int) -> str:
    """Mean NEES, and whether it lies in the 95 % interval of the independent ones."""
    if not found:
        return "–"
    mean = float(np.mean([pair.nees for pair in found]))
    independent = max(1, len(found) // max(step, 1))
    low, high = chi2.ppf([0.025, 0.975], 6 * independent) / independent
    mark = "" if step == 0 else "too large" if mean < low else "too small" if mean > high else "✓"
    return f"{mean:.1f} {mark}".strip()


def main() -> None:
    """Measure and print the table, and the mean over the recordings."""
    parser = parser_of("nees", __doc__, "config", "set")
    parser.add_argument("recordings", nargs="+", type=Path, help="folders with exact ground truth")
    parser.add_argument("--mode", choices=("stereo", "mono"), default="stereo")
    options = parser.parse_args()
    config = load_config(options.config, options.set)
    print(HEADING)
    means: dict[int, list[float]] = {step: [] for step in (0, *STEPS)}
    for folder in options.recordings:
        count, found = measure(folder, options.mode, config)
        cells = " | ".join(cell(found[step], step) for step in means)
        print(f"| {folder.name} | {options.mode} | {count} | {cells} |", flush=True)
        for step, some in found.items():
            if some:
                means[step].append(float(np.mean([pair.nees for pair in some])))
    mean = " | ".join(f"{np.mean(some):.1f}" if some else "–" for some in means.values())
    print(f"| mean | {options.mode} | | {mean} |")


if __name__ == "__main__":
    sys.exit(main())
