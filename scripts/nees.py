"""Normalised squared errors (NEES) of keyframes and of steps between them, by recording.

NEES = xi^T C^-1 xi with true = estimate exp(xi), 6 degrees of freedom: 6 on average if C is right.
Poses are compared from the segment's first keyframe on, where estimate and truth are laid upon
each other; in mono the unit of length is that in which the first keyframes lie as far from the
first as they truly do. Steps between keyframes k apart share few errors if k is large, so that
their number divided by k is taken for the number of independent ones in the 95 % interval.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from vo import odometry
from vo.backend.covariance import propagated
from vo.backend.sliding_window import Window, take_in
from vo.backend.solution import WindowSolution
from vo.config import Config, load_config
from vo.evaluation.association import associate
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import adjoint, inverse, se3_log
from vo.mapping.local_map import Keyframe, Map
from vo.sources.registry import open_source
from vo.types import Floats, Ints, KeyframePose, Mode, Trajectory

STEPS = (1, 5, 20)
LEAST_KEYFRAMES = 10  # a shorter segment says nothing
SCALE_FROM = 7  # keyframes from whose distances mono's unit of length is taken
HEADING = """\
| recording | mode | keyframes | poses | steps 1 | steps 5 | steps 20 |
| --- | --- | ---: | ---: | ---: | ---: | ---: |"""


class Pair(NamedTuple):
    """What is said and what is true of a pose against another one."""

    xi: Floats
    covariance: Floats

    @property
    def nees(self) -> float:
        """xi^T C^-1 xi."""
        return float(self.xi @ np.linalg.solve(self.covariance, self.xi))


class Watch:
    """Keeps the joint covariance of all keyframes while the odometry forgets the old ones."""

    def __init__(self, memory: int) -> None:
        self._memory = memory
        self.ids: list[int] = []
        self.turn = np.eye(6)
        self._blocks: dict[tuple[int, int], Floats] = {}

    def take_in(
        self,
        world: Map,
        window: Window,
        solution: WindowSolution,
        rig: RectifiedRig,
        config: Config,
    ) -> list[Keyframe]:
        """What the odometry calls; the same, and watched."""
        moved = take_in(world, window, solution, rig, config)
        if solution.converged:
            self.turn = adjoint(rig.cam0_from_rectified)
            self._note([keyframe.id for keyframe in window.keyframes], solution)
        return moved

    def covariance(self, row: int, column: int) -> Floats | None:
        """(6, 6) in the cam0 frames, None if it is not known."""
        block = self._blocks.get((max(row, column), min(row, column)))
        if block is None or not np.isfinite(block).all():
            return None
        return np.asarray(self.turn @ (block if row >= column else block.T) @ self.turn.T)

    def _note(self, ids: list[int], solution: WindowSolution) -> None:
        for new in ids[:1] if ids[0] not in self.ids else []:
            self._blocks[new, new] = np.zeros((6, 6))  # a segment's first
            self.ids = []
        older = [k for k in self.ids if k < ids[0]][-self._memory :]
        every, extra = older + ids, len(older)
        known = np.full((6 * len(every), 6 * len(every)), np.nan)
        for a, row in enumerate(every):
            for b, column in enumerate(every[: a + 1]):
                block = self._blocks.get((row, column), np.full((6, 6), np.nan))
                known[6 * a : 6 * a + 6, 6 * b : 6 * b + 6] = block
                known[6 * b : 6 * b + 6, 6 * a : 6 * a + 6] = block.T
        information = np.zeros_like(known)
        information[6 * extra :, 6 * extra :] = solution.information
        held = np.concatenate([np.ones(extra, dtype=bool), solution.held])
        joint = propagated(information, held, known)
        for a, row in enumerate(every):
            for b, column in enumerate(every[: a + 1]):
                self._blocks[row, column] = joint[6 * a : 6 * a + 6, 6 * b : 6 * b + 6].copy()
        self.ids = older + ids


def pairs(
    keyframes: list[KeyframePose], ids: Ints, true: Floats, watch: Watch, mono: bool
) -> dict[int, list[Pair]]:
    """Of one segment: by step, 0 for poses against the first keyframe."""
    found = np.stack([k.world_from_cam0 for k in keyframes])
    found, true = inverse(found[0]) @ found, inverse(true[0]) @ true
    scale = 1.0
    if mono:
        near, truly = found[1:SCALE_FROM, :3, 3], true[1:SCALE_FROM, :3, 3]
        scale = float((near * truly).sum() / (near**2).sum())
        found[:, :3, 3] *= scale
    size = np.r_[np.ones(3), np.full(3, scale)]
    unit = size[:, None] * size
    result: dict[int, list[Pair]] = {0: []}
    for k, pose in enumerate(keyframes[1:], start=1):
        if pose.covariance is not None:
            xi = se3_log(inverse(found[k]) @ true[k])
            result[0].append(Pair(xi, unit * pose.covariance))
    for step in STEPS:
        result[step] = []
        for i in range(len(keyframes) - step):
            j = i + step
            own = watch.covariance(ids[i], ids[i]), watch.covariance(ids[j], ids[j])
            shared = watch.covariance(ids[i], ids[j])
            if own[0] is None or own[1] is None or shared is None:
                continue
            between = inverse(found[i]) @ found[j]
            # true_i = found_i exp(a), true_j = found_j exp(b): xi = b - Ad(between^-1) a.
            xi = se3_log(inverse(between) @ inverse(true[i]) @ true[j])
            carry = adjoint(inverse(between))
            cross = carry @ (unit * shared)
            spread = carry @ (unit * own[0]) @ carry.T + unit * own[1] - cross - cross.T
            result[step].append(Pair(xi, spread))
    return result


def measure(folder: Path, mode: Mode, config: Config) -> tuple[int, dict[int, list[Pair]]]:
    """Number of keyframes, and pairs by step, of one recording."""
    source = open_source(folder, mode=mode)
    if source.ground_truth is None:
        raise SystemExit(f"error: {folder} has no truth")
    watch = Watch(max(STEPS))
    odometry.take_in = watch.take_in
    with closing(odometry.Odometry(source.rig, config)) as runner:
        for _ in runner.steps(source.frames()):
            pass
        runner.finish()
        keyframes = runner.history.keyframes()
    result: dict[int, list[Pair]] = {step: [] for step in (0, *STEPS)}
    for segment in sorted({k.segment for k in keyframes}):
        rows = [i for i, k in enumerate(keyframes) if k.segment == segment]
        stamps = np.array([keyframes[i].stamp_ns for i in rows])
        poses = np.stack([keyframes[i].world_from_cam0 for i in rows])
        matched = associate(Trajectory(stamps, poses), source.ground_truth, interpolated=True)
        there = np.isin(stamps, matched.stamps_ns)
        ids = np.array(rows)[there]  # keyframes are numbered from 0
        if len(ids) < LEAST_KEYFRAMES:
            continue
        mine = pairs([keyframes[i] for i in ids], ids, matched.reference, watch, mode == "mono")
        for step, more in mine.items():
            result[step] += more
    return len(keyframes), result


def cell(found: list[Pair], step: int) -> str:
    """Mean NEES, and whether it lies in the 95 % interval of as many independent ones."""
    if not found:
        return "–"
    mean = float(np.mean([pair.nees for pair in found]))
    independent = max(1, len(found) // max(step, 1))
    low, high = chi2.ppf([0.025, 0.975], 6 * independent) / independent
    mark = "" if step == 0 else "too large" if mean < low else "too small" if mean > high else "✓"
    return f"{mean:.1f} {mark}".strip()


def main() -> None:
    """Measure and print the table, and the mean over the recordings."""
    parser = argparse.ArgumentParser(prog="scripts/nees", description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path, help="folders with exact truth")
    parser.add_argument("--mode", choices=("stereo", "mono"), default="stereo")
    parser.add_argument("--config", default="default", help="preset or file")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
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
