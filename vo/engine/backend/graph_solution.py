"""Solution of a pose graph: true loops, worlds, poses and covariances of all keyframes."""

from __future__ import annotations

import logging

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.chain_merging import (
    doubted_markers,
    place_chains,
    plausible_loops,
    with_contradicted_doubts,
    with_supported,
    without_weak_merges,
    worlds_of,
)
from vo.engine.backend.chain_motion import USUAL, ChainMotions, motions_of
from vo.engine.backend.chain_reduction import ReducedGraph, expand, reduce_graph
from vo.engine.backend.graph_problem import GraphProblem
from vo.engine.backend.loop_edges import LoopEdges, loop_edges
from vo.engine.backend.robust_graph import keep_true_loops, optimise
from vo.engine.geometry import sim3
from vo.engine.places.records import PlaceKey, RegisteredKeyframes

_log = logging.getLogger(__name__)


def optimise_graph(problem: GraphProblem) -> RegisteredKeyframes:
    """Place all keyframes in worlds.

    Loops must agree with odometry, or, between chains, with each other; across doubted motions they
    may contradict odometry as well. Of those that do the true ones are found by graduated
    non-convexity, and all poses by least squares with the usual drift of odometry. The first
    keyframe of the first chain of each world stays where it is.

    Raises:
        ValueError: a loop is between keyframes that are not in the graph.
    """
    loops = loop_edges(problem)
    try:
        return _solved(problem, loops)
    except np.linalg.LinAlgError as error:
        _log.warning("the pose graph has no solution, loops are left out: %s", error)
        return _unplaced(problem)


def _solved(problem: GraphProblem, loops: LoopEdges) -> RegisteredKeyframes:
    problem = with_contradicted_doubts(problem, loops)
    motions = motions_of(problem)
    kept = _supported_loops(problem, loops, motions)
    chosen = loops.select(kept)
    world = worlds_of(problem, chosen)
    motions = motions_of(problem, metric_drift=USUAL)
    poses, covariance = _optimised(problem, chosen, motions, world)
    scale = np.where(problem.is_metric, problem.scale, sim3.scale_of(poses))
    rigid = sim3.rigid_part(poses)
    moved = problem.chain[np.concatenate([chosen.earlier, chosen.later])]
    alone = ~np.isin(problem.chain, moved)  # keep every bit
    scale[alone], rigid[alone] = problem.scale[alone], problem.odom_from_cam[alone]
    in_world = covariance[:, :6, :6]
    in_world[:, 3:] *= scale[:, None, None]
    in_world[:, :, 3:] *= scale[:, None, None]
    return RegisteredKeyframes(
        tuple(PlaceKey(int(s), int(k)) for s, k in problem.keys),
        world,
        rigid,
        scale,
        in_world,
        tuple(loop for loop, is_kept in zip(problem.loops, kept, strict=True) if not is_kept),
        _wrong_motions(problem, chosen),
    )


def _wrong_motions(problem: GraphProblem, loops: LoopEdges) -> tuple[PlaceKey, ...]:
    """Keyframes that a doubted motion leads to, which accepted loops replace."""
    ends = loops.earlier, loops.later
    first, last = np.minimum(*ends), np.maximum(*ends)
    inside = problem.chain[first] == problem.chain[last]
    return tuple(
        PlaceKey(int(problem.keys[n, 0]), int(problem.keys[n, 1]))
        for n in np.flatnonzero(problem.is_doubted)
        if (inside & (first < n) & (n <= last)).any()
    )


def _supported_loops(problem: GraphProblem, loops: LoopEdges, motions: ChainMotions) -> Bools:
    """(L,) loops that are accepted, and those that only odometry over a long path contradicts.

    The latter are refused if they contradict any of the former.
    """
    plausible = plausible_loops(problem, loops, motions)
    kept = _true_loops(problem, loops, motions, plausible)
    supported = with_supported(problem, loops, motions, plausible, kept)
    if (supported == kept).all():
        return kept
    more = _consistent_loops(problem, loops, motions, supported)
    return kept if (kept & ~more).any() else more


def _true_loops(
    problem: GraphProblem, loops: LoopEdges, motions: ChainMotions, plausible: Bools
) -> Bools:
    """(L,) loops that are accepted.

    Loops by the look of places are believed before those by markers, which may have been moved.
    """
    kept = _consistent_loops(problem, loops, motions, plausible)
    by_look = plausible & (loops.marker < 0)
    if (by_look == plausible).all():
        return kept
    alone = _consistent_loops(problem, loops, motions, by_look)
    if (alone & ~kept).any():
        return alone
    doubted = doubted_markers(problem, loops, plausible, kept)
    if len(doubted) == 0:
        return kept
    trusted = plausible & ~np.isin(loops.marker, doubted)
    return _consistent_loops(problem, loops, motions, trusted)


def _consistent_loops(
    problem: GraphProblem, loops: LoopEdges, motions: ChainMotions, plausible: Bools
) -> Bools:
    """(L,) plausible loops that agree with each other."""
    kept = plausible.copy()
    while kept.any():
        chosen = loops.select(kept)
        reduced = reduce_graph(problem, motions, chosen)
        start = place_chains(problem, chosen, motions)[reduced.knots]
        gauge = _gauge(problem, worlds_of(problem, chosen), reduced)
        kept[kept] = keep_true_loops(start, gauge, reduced.odometry, reduced.loops)
        strong = without_weak_merges(problem, loops, kept)
        if (strong == kept).all():
            break
        kept = strong
    return kept


def _optimised(
    problem: GraphProblem, loops: LoopEdges, motions: ChainMotions, world: Ints
) -> tuple[Floats, Floats]:
    """Poses (n, 4, 4) and covariances (n, 7, 7) of all rows in their worlds."""
    if len(loops) == 0:
        first = np.flatnonzero(np.r_[True, world[1:] != world[:-1]])
        start_of = np.repeat(first, np.diff(np.r_[first, len(world)]))
        return motions.odom_from_cam.copy(), motions.covariance(start_of, np.arange(len(world)))
    reduced = reduce_graph(problem, motions, loops)
    start = place_chains(problem, loops, motions)[reduced.knots]
    gauge = _gauge(problem, world, reduced)
    found = optimise(start, gauge, reduced.odometry, reduced.loops)
    poses, covariance = expand(reduced, motions, found.world_from, found.single, found.joint)
    for n in gauge:  # exactly
        first = reduced.knots[n]
        exact = motions.odom_from_cam[first] @ sim3.inverse(poses[first])
        rows = world == world[first]
        poses[rows] = exact @ poses[rows]
    return poses, covariance


def _gauge(problem: GraphProblem, world: Ints, reduced: ReducedGraph) -> Ints:
    """The first pose of the first chain of each world."""
    of_first = problem.chain[reduced.knots] == world[reduced.knots]
    _, first = np.unique(world[reduced.knots][of_first], return_index=True)
    return np.asarray(np.flatnonzero(of_first)[first])


def _unplaced(problem: GraphProblem) -> RegisteredKeyframes:
    """All keyframes where odometry has them, and no loop accepted."""
    count = len(problem.keys)
    return RegisteredKeyframes(
        tuple(PlaceKey(int(s), int(k)) for s, k in problem.keys),
        problem.chain,
        problem.odom_from_cam,
        problem.scale,
        np.full((count, 6, 6), np.nan),
        problem.loops,
    )
