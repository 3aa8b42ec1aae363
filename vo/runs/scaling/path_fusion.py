"""A path moved by positions and wheels: factors of a pose graph of its keyframes.

Odometry and accepted loops hold the path together, positions hold it in their frame, and ways of
wheels its lengths. How exact the positions are, and how much odometry drifts, is estimated from how
they differ; what positions say of themselves counts relative to each other only. Where a path
without drift explains the differences as well, nothing moves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.chain_reduction import ReducedGraph, expand
from vo.engine.backend.graph_problem import Edges
from vo.engine.geometry import sim3
from vo.engine.geometry.levenberg_marquardt import Law, minimise
from vo.runs.scaling.path_factors import (
    Fixes,
    Given,
    axis_sigmas,
    grouped,
    pieces_of,
    positions_of,
    sigma_of,
    white_sigma,
    without_outliers,
)
from vo.runs.scaling.path_graph import Noise, PathGraph, PathMotions, State
from vo.runs.scaling.position_noise import estimate_noise

_MIN_FIXES = 10
_GROUPS, _COARSE_GROUPS = 250, 60  # positions; more are averaged
_ROUNDS = 3  # of the noise and of the positions that are refused
_EVIDENCE = -3.0  # logarithm of the ratio of likelihoods, above which the path moves
_MAX_MOVED = 0.25  # of the extent of the path: more is no drift
_SIGNIFICANT = 1.5  # movement, relative to what stays uncertain
_COMPARED, _KNOTS = 40, 300  # keyframes of it; those of the solution, besides those of factors
_REFUSED = 35.0  # squared distance of three numbers, in variances
_USUAL_SQUARED = 2.366  # its median
_SLOW_S = 30.0  # where the search begins
_LAW = Law(5, 1e-6, damping=1e-9)


class FusedPath(NamedTuple):
    """A path that positions or wheels have moved.

    Attributes:
        poses: (n, 4, 4) similarities, in the frame of the positions.
        from_first: (n, 7, 7) covariances relative to the first pose, in their own frames.
        in_frame: (n, 7, 7) covariances in the frame of the positions.
        used: (M,) positions that are not refused.
        noise: of the positions and of odometry.
        jumps: of the positions.
        is_moved: whether the path had to move; if not, only the frame of the positions changed.
    """

    poses: Floats
    from_first: Floats
    in_frame: Floats
    used: Bools
    noise: Noise
    jumps: int
    is_moved: bool


def fuse_path(poses: Floats, fixes: Fixes, given: Given) -> FusedPath | None:
    """Move a path to where odometry, loops, positions and wheels agree best.

    Args:
        poses: (n, 4, 4) keyframes in metres, in the frame of the positions.
        fixes: the positions; without any, wheels alone.
        given: everything else that is known.

    Returns:
        None for too few positions; the path as it was where the graph is not determined.
    """
    centre = (fixes.xyz if len(fixes.at) else poses[:, :3, 3]).mean(axis=0)
    shifted = poses.copy()
    shifted[:, :3, 3] -= centre
    try:
        found = _fused(shifted, replace(fixes, xyz=fixes.xyz - centre), given)
    except np.linalg.LinAlgError:
        used = np.ones(len(fixes.at), bool)
        found = _unmoved(shifted, used, Noise(0.0, 0.0, _SLOW_S))
    if found is not None:
        found.poses[:, :3, 3] += centre
    return found


def _fused(poses: Floats, fixes: Fixes, given: Given) -> FusedPath | None:
    used = without_outliers(fixes, fixes.xyz - positions_of(poses, fixes))
    fewest = _MIN_FIXES if len(fixes.at) or given.ways is None else 0
    if used.sum() < fewest:
        return None
    fusion = _Fusion(poses, given)
    for _ in range(_ROUNDS):
        left = fixes.rows(used)
        piece = pieces_of(left, left.xyz - positions_of(fusion.poses, left))
        is_moved = fusion.learn(left, piece)
        if not is_moved:
            break
        refused = fusion.refused(left, piece)
        used[np.flatnonzero(used)[refused]] = False
        if used.sum() < fewest:
            return None
        piece = piece[~refused]
        fusion.move(fixes.rows(used), piece)
    off = np.linalg.norm((fusion.poses - poses)[:, :3, 3], axis=1)
    extent = float(np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)))
    if not is_moved or np.sqrt((off**2).mean()) > _MAX_MOVED * extent:
        return _unmoved(poses, used, fusion.noise)
    from_first, in_frame = fusion.covariances()
    jumps = max(len(np.unique(piece)) - 1, 0)
    return FusedPath(fusion.poses, from_first, in_frame, used, fusion.noise, jumps, is_moved)


def _unmoved(poses: Floats, used: Bools, noise: Noise) -> FusedPath:
    unknown = np.full((len(poses), 7, 7), np.nan)
    return FusedPath(poses, unknown, unknown, used, noise, 0, False)


class _Fusion:
    """The path so far."""

    def __init__(self, poses: Floats, given: Given) -> None:
        self.poses, self.noise = poses, Noise(0.0, 0.0, _SLOW_S)
        self._given, self._motions = given, PathMotions(poses, given)
        self._solved: tuple[PathGraph, State] | None = None

    def _graph(self, fixes: Fixes, piece: Ints, most: int, knots: int) -> PathGraph:
        (groups, number), given = grouped(self.poses, fixes, piece, most), self._given
        axes = axis_sigmas(fixes.xyz - positions_of(self.poses, fixes))
        piece = piece[np.searchsorted(number, np.arange(len(groups.at)))]
        ends = [groups.at, given.loops.a, given.loops.b]
        if given.ways is not None:
            ends += [given.ways.at, given.ways.since]
        spaced = np.linspace(0, len(self.poses) - 1, knots).astype(np.int64)
        rows = np.unique(np.concatenate([spaced, *ends]))
        graph = PathGraph(self._motions, self.poses, rows, groups, piece, axes, given)
        graph.noise = self.noise
        return graph

    def learn(self, fixes: Fixes, piece: Ints) -> bool:
        """Estimate the noise; whether errors of the path show in the positions."""
        graph = self._graph(fixes, piece, _COARSE_GROUPS, _COMPARED)
        residuals = fixes.xyz - positions_of(self.poses, fixes)
        white_m, slow_m = max(white_sigma(residuals), 1e-3), max(sigma_of(residuals), 1e-3)
        given = graph, self._given.smallest_m, white_m
        if self.noise.factors:
            self.noise, _ = estimate_noise(*given, self.noise)
            return True
        usual = (1.0,) * self._motions.kinds
        still, alone = estimate_noise(*given, Noise(white_m, slow_m, _SLOW_S))
        starts = Noise(white_m, white_m, _SLOW_S, usual), still._replace(factors=usual)
        found = [estimate_noise(*given, each) for each in starts]
        self.noise, value = max(found, key=lambda each: each[1])
        graph.noise = self.noise
        if value - alone > _EVIDENCE and _significance(graph) > _SIGNIFICANT:
            return True
        self.noise = still
        return False

    def refused(self, fixes: Fixes, piece: Ints) -> Bools:
        """(M,) positions that contradict all others and the path."""
        if not len(fixes.at):
            return np.zeros(0, bool)
        graph = self._graph(fixes, piece, _GROUPS, _COMPARED)
        squared = graph.contradiction(minimise(graph, graph.start, _LAW))
        limit = _REFUSED * max(1.0, float(np.median(squared)) / _USUAL_SQUARED)
        return np.asarray(squared[grouped(self.poses, fixes, piece, _GROUPS)[1]] > limit)

    def move(self, fixes: Fixes, piece: Ints) -> None:
        """Move the path to where all agree best."""
        graph = self._graph(fixes, piece, _GROUPS, min(_KNOTS, len(self.poses)))
        state = minimise(graph, graph.start, _LAW)
        self._solved = graph, state
        self.poses = self._all(*graph.covariances(state)[:2])[0]

    def _all(self, single: Floats, across: Floats) -> tuple[Floats, Floats]:
        """Poses and covariances of all keyframes by those of the graph."""
        assert self._solved is not None
        graph, state = self._solved
        knots, motions = graph.knots, self._motions.with_factors(self.noise)
        a, b = np.arange(len(knots) - 1), np.arange(1, len(knots))
        between = motions.motion(knots[a], knots[b]), motions.covariance(knots[a], knots[b])
        pose = np.searchsorted(knots, np.arange(len(self.poses)), side="right") - 1
        joint = np.block([[single[a], across], [np.swapaxes(across, 1, 2), single[b]]])
        edges = Edges(a, b, *between)
        return expand(ReducedGraph(knots, pose, edges, edges), motions, state.poses, single, joint)

    def covariances(self) -> tuple[Floats, Floats]:
        """Covariances relative to the first pose, and in the frame of the positions."""
        assert self._solved is not None
        graph, state = self._solved
        single, across, to_first = graph.covariances(state)
        in_frame = self._all(single, across)[1]
        by_first = -sim3.adjoint(sim3.inverse(state.poses) @ state.poses[0])
        by_first[:, :, 6] = 0.0  # of the scale all that is not known counts
        turned = np.swapaxes(by_first, 1, 2)

        def less_first(spread: Floats, a: Ints, b: Ints) -> Floats:
            spread = spread + by_first[a] @ (to_first[b] + single[0] @ turned[b])
            return np.asarray(spread + np.swapaxes(to_first[a], 1, 2) @ turned[b])

        rows = np.arange(len(single))
        a, b = rows[:-1], rows[1:]
        return self._all(less_first(single, rows, rows), less_first(across, a, b))[1], in_frame


def _significance(graph: PathGraph) -> float:
    """How far the path would move, relative to how uncertain it would still be."""
    state = minimise(graph, graph.start, _LAW)
    single, _, to_first = graph.covariances(state)
    chosen = np.searchsorted(graph.knots, np.linspace(0, graph.knots[-1], _COMPARED).astype(int))
    if len(graph.times_s):
        moved = state.poses[chosen, :3, 3] - graph.start.poses[chosen, :3, 3]
        scale = sim3.scale_of(state.poses[chosen])
        left = scale**2 * np.trace(single[chosen, 3:6, 3:6], axis1=1, axis2=2)
    else:  # wheels measure the drift of the scale, and nothing else
        drift = np.log(sim3.scale_of(state.poses[chosen]))
        moved = drift - drift[0] - np.log(sim3.scale_of(graph.start.poses[chosen]))
        left = (single[:, 6, 6] + single[0, 6, 6] - 2.0 * to_first[:, 6, 6])[chosen]
    return float(np.sqrt((moved**2).sum() / max(left.sum(), 1e-300)))
