"""Chains of keyframes connected by loops: which loops are plausible, and initial poses.

Motions in chains that are doubted, and that loops contradict, are like gaps between two chains.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.chain_motion import ChainMotions, motions_of
from vo.engine.backend.graph_problem import GraphProblem
from vo.engine.backend.loop_edges import (
    LoopEdges,
    agreement,
    agrees_with_odometry,
    largest_agreeing,
    supported,
)
from vo.engine.geometry import sim3

# Later keyframes whose loops must agree before two chains are merged, or the parts beside a doubted
# motion: there is no odometry between them. A second set that agrees on another relation must be
# half as large at most.
_MIN_KEYFRAMES = 3
_MAX_COMPARED = 200  # newest loops between two chains


def plausible_loops(problem: GraphProblem, loops: LoopEdges, motions: ChainMotions) -> Bools:
    """(L,) loops that odometry, or enough other loops between the same chains, agree with.

    A marker of which one loop contradicts odometry was moved, or there are two of its id: then none
    of its loops is plausible. So it is with those that are doubted from the start.
    """
    earlier, later = problem.chain[loops.earlier], problem.chain[loops.later]
    inside = np.flatnonzero(earlier == later)
    result = np.zeros(len(loops), dtype=bool)
    result[inside] = agrees_with_odometry(loops.select(inside), motions)
    contradicted = loops.marker[inside][~result[inside]]
    doubtful = np.isin(loops.marker, [*contradicted[contradicted >= 0], *problem.doubted])
    comparable = problem.is_metric[loops.earlier] == problem.is_metric[loops.later]
    result |= comparable & (earlier != later)
    result &= ~doubtful
    for rows in _by_pair_of_parts(problem, loops, result):
        result[rows] = False
        result[_agreeing_pair(loops, rows[-_MAX_COMPARED:], motions)] = True
    return result


def with_supported(
    problem: GraphProblem, loops: LoopEdges, motions: ChainMotions, plausible: Bools, kept: Bools
) -> Bools:
    """(L,) loops that are kept, and those that only odometry contradicts, in chains."""
    result, chain = kept.copy(), problem.chain[loops.earlier]
    by_look = (chain == problem.chain[loops.later]) & (loops.marker < 0)
    refused = by_look & ~plausible & ~kept
    for number in set(chain[refused].tolist()):
        rows = np.flatnonzero(by_look & (chain == number) & (kept | refused))
        result[rows] = supported(loops.select(rows), kept[rows], motions)
    return result


def with_contradicted_doubts(problem: GraphProblem, loops: LoopEdges) -> GraphProblem:
    """The graph, with only those of its doubted motions that loops contradict.

    Loops across them must agree as those between chains, on a relation that odometry excludes.
    Those by markers, which may have been moved, do not count.
    """
    trusted = replace(problem, is_doubted=np.zeros(len(problem.keys), dtype=bool))
    crosses = problem.part[loops.earlier] != problem.part[loops.later]
    crosses &= loops.marker < 0
    crosses &= problem.chain[loops.earlier] == problem.chain[loops.later]
    if not crosses.any():
        return trusted
    motions, contradicted = motions_of(problem), trusted.is_doubted.copy()
    by_odometry = agrees_with_odometry(loops.select(crosses), motions_of(trusted))
    disagrees = crosses.copy()
    disagrees[crosses] = ~by_odometry
    crosses[crosses] = agrees_with_odometry(loops.select(crosses), motions)
    for rows in _by_pair_of_parts(problem, loops, crosses):
        found = _agreeing_pair(loops, rows[-_MAX_COMPARED:], motions)
        if 2 * disagrees[found].sum() > len(found):
            first = int(np.minimum(loops.earlier[found], loops.later[found]).max())
            last = int(np.maximum(loops.earlier[found], loops.later[found]).min())
            contradicted[first + 1 : last + 1] |= problem.is_doubted[first + 1 : last + 1]
    return replace(problem, is_doubted=contradicted)


def doubted_markers(problem: GraphProblem, loops: LoopEdges, plausible: Bools, kept: Bools) -> Ints:
    """Ids of which a plausible loop within a chain is not among those kept (L,).

    All ids if these are half of them or more, as it is then unknown which markers were moved.
    """
    plausible = plausible & (loops.marker >= 0)
    inside = problem.chain[loops.earlier] == problem.chain[loops.later]
    ids, refused = (
        np.array(sorted(set(loops.marker[rows].tolist())), np.int64)
        for rows in (plausible, plausible & inside & ~kept)
    )
    return ids if 2 * len(refused) >= len(ids) else refused


def without_weak_merges(problem: GraphProblem, loops: LoopEdges, kept: Bools) -> Bools:
    """(L,) the loops kept, without those between parts that too few of them connect."""
    result = kept.copy()
    for rows in _by_pair_of_parts(problem, loops, kept):
        if _keyframes(loops, rows) < _MIN_KEYFRAMES:
            result[rows] = False
    return result


def _keyframes(loops: LoopEdges, rows: Ints) -> int:
    """Number of later keyframes that loops rest on, those of a marker with others of its visit."""
    later, index = np.unique(loops.later[rows], return_inverse=True)
    support = np.zeros(len(later), np.int64)
    np.maximum.at(support, index, loops.support[rows])
    return int(support.sum())


def _by_pair_of_parts(problem: GraphProblem, loops: LoopEdges, chosen: Bools) -> list[Ints]:
    """Those of the chosen loops that connect two parts, by the pair of them."""
    part = problem.part
    pairs = np.sort(np.stack([part[loops.earlier], part[loops.later]], axis=1), axis=1)
    between = chosen & (pairs[:, 0] != pairs[:, 1])
    return [
        np.flatnonzero(between & (pairs == pair).all(axis=1))
        for pair in sorted(set(map(tuple, pairs[between].tolist())))
    ]


def _agreeing_pair(loops: LoopEdges, rows: Ints, motions: ChainMotions) -> Ints:
    """The rows that agree with each other; none if they are too few, or if others disagree."""
    if loops.support[rows].sum() < _MIN_KEYFRAMES:
        return rows[:0]
    agree = agreement(loops.select(rows), motions)
    best = largest_agreeing(agree)
    # Loops that agree with none of the best support another relation, as in a copy of a place.
    others = np.flatnonzero(~agree[:, best].any(axis=1))
    second = largest_agreeing(agree[np.ix_(others, others)]) if len(others) else others
    first, other = (int(loops.support[rows[each]].sum()) for each in (best, second))
    if _keyframes(loops, rows[best]) < _MIN_KEYFRAMES or 2 * other > first:
        return rows[:0]
    return rows[best]


def worlds_of(problem: GraphProblem, loops: LoopEdges) -> Ints:
    """(n,) number of the first chain of those that each row's chain is connected with."""
    world = {name: name for name in sorted(set(problem.chain.tolist()))}
    for a, b in zip(problem.chain[loops.earlier], problem.chain[loops.later], strict=True):
        first, second = sorted((world[int(a)], world[int(b)]))
        world = {name: first if of == second else of for name, of in world.items()}
    return np.array([world[int(c)] for c in problem.chain], dtype=np.int64)


def place_chains(problem: GraphProblem, loops: LoopEdges, motions: ChainMotions) -> Floats:
    """(n, 4, 4) first guess of all rows in the frames of their worlds.

    A part of a chain that no loop connects is placed by the doubted motion beside it.
    """
    poses, part = motions.odom_from_cam, problem.part
    _, first_row = np.unique(problem.chain, return_index=True)
    first_part = dict(zip(problem.chain[first_row].tolist(), part[first_row].tolist(), strict=True))
    placed = {first_part[c]: np.eye(4) for c in set(worlds_of(problem, loops).tolist())}
    ends = list(zip(part[loops.earlier].tolist(), part[loops.later].tolist(), strict=True))
    goes_on = (problem.chain[1:] == problem.chain[:-1]) & (part[1:] != part[:-1])
    beside = [(int(p) - 1, int(p)) for p in part[1:][goes_on]]
    while True:
        half_placed = (n for n, (a, b) in enumerate(ends) if (a in placed) != (b in placed))
        n = next(half_placed, None)
        if n is None:
            joined = next((p for p in beside if (p[0] in placed) != (p[1] in placed)), None)
            if joined is None:
                break
            a, b = joined if joined[0] in placed else joined[::-1]
            placed[b] = placed[a]
            continue
        a, b = ends[n]
        at_earlier, at_later = poses[loops.earlier[n]], poses[loops.later[n]]
        relation = loops.relation[n]
        if a in placed:
            placed[b] = placed[a] @ at_earlier @ relation @ sim3.inverse(at_later)
        else:
            placed[a] = placed[b] @ at_later @ sim3.inverse(relation) @ sim3.inverse(at_earlier)
    return np.stack([placed[int(p)] for p in part]) @ poses
