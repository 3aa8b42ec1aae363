"""Loops of a pose graph as arrays, and which of them agree with odometry and with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.chain_motion import FIXED_LOG_SCALE, ChainMotions
from vo.engine.backend.graph_problem import GraphProblem
from vo.engine.geometry import sim3
from vo.engine.places.records import PlaceKey

# Squared Mahalanobis distance of seven numbers that errors exceed once in 10,000 times.
GATE = 29.9
# Loops that support one that contradicts odometry, all of so many nearest ones. Its own keyframes
# are so many times further apart along the path than it is from them.
_MIN_SUPPORTING, _MAX_SUPPORTING, _SHORTER = 3, 5, 3
_MIN_LOG_SCALE = 1e-4  # standard deviation that a measured scale has at least


@dataclass(frozen=True, eq=False)
class LoopEdges:
    """L loops between rows of a graph.

    Attributes:
        relation: (L, 4, 4) similarities earlier_from_later.
        covariance: (L, 7, 7) in the frame of the later keyframe.
        support: (L,) later keyframes that each rests on.
        marker: (L,) ids of markers, -1 for loops by the look of a place.
    """

    earlier: Ints
    later: Ints
    relation: Floats
    covariance: Floats
    support: Ints
    marker: Ints

    def __len__(self) -> int:
        return len(self.earlier)

    def select(self, chosen: Bools | Ints) -> LoopEdges:
        """Some of the loops."""
        return LoopEdges(*(field[chosen] for field in vars(self).values()))


def loop_edges(problem: GraphProblem) -> LoopEdges:
    """The loops of a graph, in their order.

    Raises:
        ValueError: a loop is between keyframes that are not in the graph.
    """
    row = {PlaceKey(int(s), int(k)): n for n, (s, k) in enumerate(problem.keys)}
    loops = problem.loops
    for loop in loops:
        for key in (loop.earlier, loop.later):
            if key not in row:
                raise ValueError(f"a loop needs the keyframe {tuple(key)}, which is not stored")
    relation = np.zeros((len(loops), 4, 4))
    covariance = np.zeros((len(loops), 7, 7))
    for n, loop in enumerate(loops):
        relation[n] = sim3.similarity(loop.earlier_from_later, loop.scale)
        covariance[n] = loop.covariance
    later = np.array([row[loop.later] for loop in loops], dtype=np.int64)
    # The scale of metric loops is known; a matrix must have an inverse all the same.
    floor = np.where(problem.is_metric[later], FIXED_LOG_SCALE, _MIN_LOG_SCALE) ** 2
    covariance[problem.is_metric[later], 6, 6] = 0.0
    covariance[:, 6, 6] = np.maximum(covariance[:, 6, 6], floor)
    return LoopEdges(
        np.array([row[loop.earlier] for loop in loops], dtype=np.int64),
        later,
        relation,
        covariance,
        np.array([loop.support for loop in loops], dtype=np.int64),
        np.array([-1 if loop.marker is None else loop.marker for loop in loops], dtype=np.int64),
    )


def agrees_with_odometry(loops: LoopEdges, motions: ChainMotions) -> Bools:
    """(L,) whether each loop, within one chain, is within reach of the drift of odometry."""
    error = sim3.local(sim3.inverse(loops.relation) @ motions.motion(loops.earlier, loops.later))
    spread = loops.covariance + motions.covariance(loops.earlier, loops.later)
    return np.asarray(squared_distance(error, spread) < GATE)


def agreement(loops: LoopEdges, motions: ChainMotions) -> Bools:
    """(L, L) whether loops between the same two chains agree with each other."""
    result = np.eye(len(loops), dtype=bool)
    first, second = np.triu_indices(len(loops), 1)
    result[first, second] = result[second, first] = _agree(loops, first, second, motions)
    return result


def _agree(loops: LoopEdges, first: Ints, second: Ints, motions: ChainMotions) -> Bools:
    """(P,) whether pairs of loops agree with each other.

    The cycle of one loop, odometry, the other loop and odometry must be the identity.

    Source: Mangelson et al., "Pairwise Consistent Measurement Set Maximization for Robust
        Multi-robot Map Merging", ICRA 2018, eq. 5.
    """
    e1, e2, l1, l2 = (
        *(loops.earlier[first], loops.earlier[second]),
        *(loops.later[first], loops.later[second]),
    )
    predicted = motions.motion(e2, e1) @ loops.relation[first] @ motions.motion(l1, l2)
    back = sim3.inverse(loops.relation[second])
    error = sim3.local(back @ predicted)
    by_first, by_earlier = motions.adjoint(l2, l1), sim3.adjoint(back)
    spread = (
        loops.covariance[second]
        + motions.covariance(l1, l2)
        + by_first @ loops.covariance[first] @ np.swapaxes(by_first, 1, 2)
        + by_earlier @ motions.covariance(e1, e2) @ np.swapaxes(by_earlier, 1, 2)
    )
    return np.asarray(squared_distance(error, spread) < GATE)


def supported(loops: LoopEdges, kept: Bools, motions: ChainMotions) -> Bools:
    """(L,) loops of one chain that are kept, and those that agree with all kept ones near them.

    Over a long path odometry may drift by more than it states. Then loops agree with odometry no
    longer, one after the other, but with the loops before them, which are far nearer on the path.
    A place that looks like another one has no such loops beside it.
    """
    result, refused = kept.copy(), np.flatnonzero(~kept)
    for row in refused[np.argsort(loops.later[refused], kind="stable")]:
        way = np.abs(loops.later - loops.later[row]) + np.abs(loops.earlier - loops.earlier[row])
        near = np.flatnonzero(
            result & (_SHORTER * way <= abs(loops.later[row] - loops.earlier[row]))
        )
        near = near[np.argsort(way[near], kind="stable")][:_MAX_SUPPORTING]
        if len(set(loops.later[near].tolist())) >= _MIN_SUPPORTING:
            result[row] = _agree(loops, near, np.full(len(near), row), motions).all()
    return result


def largest_agreeing(agree: Bools) -> Ints:
    """Rows of a large set of loops of which each agrees with each other, by `agreement` (L, L).

    From each loop on, loops are added in order of how many others they agree with.
    """
    order = np.argsort(-agree.sum(axis=1), kind="stable")
    best: list[int] = []
    for seed in order:
        if agree[seed].sum() <= len(best):
            continue
        together, chosen = agree[seed].copy(), [int(seed)]
        for row in order:
            if row != seed and together[row]:
                chosen.append(int(row))
                together &= agree[row]
        if len(chosen) > len(best):
            best = chosen
    return np.array(sorted(best), dtype=np.int64)


def squared_distance(error: Floats, covariance: Floats) -> Floats:
    """Squared Mahalanobis distances (N,) of errors (N, 7)."""
    solved = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    return np.asarray((error * solved).sum(axis=1))
