"""Chains of keyframes connected by loops: which loops are plausible, and initial poses."""

from __future__ import annotations

import numpy as np

from vo.backend.chain_motion import ChainMotions
from vo.backend.graph_problem import GraphProblem
from vo.backend.loop_edges import LoopEdges, agreement, agrees_with_odometry, largest_agreeing
from vo.geometry import sim3
from vo.types import Bools, Floats, Ints

# Loops that must agree, of as many later keyframes, before two chains are merged: there is no
# odometry between them. A second set that agrees on another relation must be half as large at most.
_MIN_LOOPS = 3
_MAX_COMPARED = 200  # newest loops between two chains


def plausible_loops(problem: GraphProblem, loops: LoopEdges, motions: ChainMotions) -> Bools:
    """(L,) loops that odometry, or enough other loops between the same chains, agree with."""
    earlier, later = problem.chain[loops.earlier], problem.chain[loops.later]
    inside = np.flatnonzero(earlier == later)
    result = np.zeros(len(loops), dtype=bool)
    result[inside] = agrees_with_odometry(loops.select(inside), motions)
    comparable = problem.is_metric[loops.earlier] == problem.is_metric[loops.later]
    for rows in _by_pair(problem, loops, comparable & (earlier != later)):
        result[_agreeing_pair(loops, rows[-_MAX_COMPARED:], motions)] = True
    return result


def without_weak_merges(problem: GraphProblem, loops: LoopEdges, kept: Bools) -> Bools:
    """(L,) the loops kept, without those between chains that too few of them connect."""
    result = kept.copy()
    apart = problem.chain[loops.earlier] != problem.chain[loops.later]
    for rows in _by_pair(problem, loops, kept & apart):
        if len(np.unique(loops.later[rows])) < _MIN_LOOPS:
            result[rows] = False
    return result


def _by_pair(problem: GraphProblem, loops: LoopEdges, chosen: Bools) -> list[Ints]:
    """Chosen loops by the pair of chains that they connect."""
    pairs = np.sort(
        np.stack([problem.chain[loops.earlier], problem.chain[loops.later]], axis=1), axis=1
    )
    return [
        np.flatnonzero(chosen & (pairs == pair).all(axis=1))
        for pair in np.unique(pairs[chosen], axis=0)
    ]


def _agreeing_pair(loops: LoopEdges, rows: Ints, motions: ChainMotions) -> Ints:
    """The rows that agree with each other; none if they are too few, or if others disagree."""
    if len(rows) < _MIN_LOOPS:
        return rows[:0]
    agree = agreement(loops.select(rows), motions)
    best = largest_agreeing(agree)
    # Loops that agree with none of the best support another relation, as in a copy of a place.
    others = np.flatnonzero(~agree[:, best].any(axis=1))
    second = largest_agreeing(agree[np.ix_(others, others)]) if len(others) else others
    if len(np.unique(loops.later[rows[best]])) < _MIN_LOOPS or 2 * len(second) > len(best):
        return rows[:0]
    return rows[best]


def worlds_of(problem: GraphProblem, loops: LoopEdges) -> Ints:
    """(n,) number of the first chain of those that each row's chain is connected with."""
    names = np.unique(problem.chain)
    world = {int(name): int(name) for name in names}
    for a, b in zip(problem.chain[loops.earlier], problem.chain[loops.later], strict=True):
        first, second = sorted((world[int(a)], world[int(b)]))
        world = {name: first if of == second else of for name, of in world.items()}
    return np.array([world[int(c)] for c in problem.chain], dtype=np.int64)


def place_chains(problem: GraphProblem, loops: LoopEdges, motions: ChainMotions) -> Floats:
    """(n, 4, 4) first guess of all rows in the frames of their worlds."""
    poses = motions.odom_from_cam
    placed = {int(c): np.eye(4) for c in np.unique(worlds_of(problem, loops))}
    earlier, later = problem.chain[loops.earlier].tolist(), problem.chain[loops.later].tolist()
    ends = list(zip(earlier, later, strict=True))
    while True:
        half_placed = (n for n, (a, b) in enumerate(ends) if (a in placed) != (b in placed))
        n = next(half_placed, None)
        if n is None:
            break
        a, b = ends[n]
        at_earlier, at_later = poses[loops.earlier[n]], poses[loops.later[n]]
        relation = loops.relation[n]
        if a in placed:
            placed[b] = placed[a] @ at_earlier @ relation @ sim3.inverse(at_later)
        else:
            placed[a] = placed[b] @ at_later @ sim3.inverse(relation) @ sim3.inverse(at_earlier)
    return np.stack([placed[int(c)] for c in problem.chain]) @ poses
