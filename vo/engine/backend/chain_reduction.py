"""A pose graph with few poses: those of the keyframes of loops, and the motions between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Floats, Ints
from vo.engine.backend.chain_motion import ChainMotions
from vo.engine.backend.graph_problem import Edges, GraphProblem
from vo.engine.backend.loop_edges import LoopEdges
from vo.engine.geometry import sim3


@dataclass(frozen=True, eq=False)
class ReducedGraph:
    """The m poses of a graph of n rows that are optimised.

    The motions between two of them are composed to one, whose covariance is the sum of theirs. All
    rows of a rigid chain share one pose.

    Attributes:
        knots: (m,) rows of the poses, increasing; the first row of each chain is one.
        pose: (n,) the pose that each row follows: that of its row or of the last one before.
    """

    knots: Ints
    pose: Ints
    odometry: Edges
    loops: Edges


def reduce_graph(problem: GraphProblem, motions: ChainMotions, loops: LoopEdges) -> ReducedGraph:
    """Reduce a graph to the keyframes of its loops and the first one of each chain."""
    is_knot = np.r_[True, problem.chain[1:] != problem.chain[:-1]]
    ends = np.concatenate([loops.earlier, loops.later])
    is_knot[ends[~problem.is_rigid[ends]]] = True
    knots = np.flatnonzero(is_knot)
    pose = np.cumsum(is_knot) - 1
    follows = np.flatnonzero(problem.chain[knots[1:]] == problem.chain[knots[:-1]])
    a, b = knots[follows], knots[follows + 1]
    odometry = Edges(follows, follows + 1, motions.motion(a, b), motions.covariance(a, b))
    return ReducedGraph(knots, pose, odometry, _between_knots(knots, pose, motions, loops))


def _between_knots(knots: Ints, pose: Ints, motions: ChainMotions, loops: LoopEdges) -> Edges:
    """Loops as relations of poses; they differ from those of their rows in rigid chains."""
    a, b = pose[loops.earlier], pose[loops.later]
    before = motions.motion(knots[a], loops.earlier)
    after = motions.motion(loops.later, knots[b])
    carried = motions.adjoint(knots[b], loops.later)
    spread = carried @ loops.covariance @ np.swapaxes(carried, 1, 2)
    return Edges(a, b, before @ loops.relation @ after, spread)


def expand(
    reduced: ReducedGraph, motions: ChainMotions, world_from: Floats, single: Floats, joint: Floats
) -> tuple[Floats, Floats]:
    """Poses (n, 4, 4) of all rows, and their covariances (n, 7, 7), of the m optimised poses.

    The correction of a motion is spread over the rows in between in proportion to their
    uncertainty: the expected errors of the rows, given that of the last one. `single` (m, 7, 7) are
    the covariances of the poses, `joint` (E, 14, 14) those of both ends of each edge of odometry.
    """
    rows = np.arange(len(reduced.pose))
    knot = reduced.knots[reduced.pose]
    moved = motions.motion(knot, rows)
    poses = world_from[reduced.pose] @ moved
    back = motions.adjoint(rows, knot)
    turned = np.swapaxes(back, 1, 2)
    spread = back @ single[reduced.pose] @ turned + motions.covariance(knot, rows)
    for edge, (i, j) in enumerate(zip(reduced.odometry.a, reduced.odometry.b, strict=True)):
        a, b = int(reduced.knots[i]), int(reduced.knots[j])
        inner = np.arange(a + 1, b)
        if len(inner) == 0:
            continue
        error = sim3.local(
            sim3.inverse(reduced.odometry.a_from_b[edge])
            @ sim3.inverse(world_from[i])
            @ world_from[j]
        )
        # In the frame of b: expected error of a row = gain @ error of b.
        with_end = motions.joint(a, inner, b)
        gain = np.swapaxes(
            np.linalg.solve(reduced.odometry.covariance[edge], np.swapaxes(with_end, 1, 2)), 1, 2
        )
        to_row = motions.adjoint(inner, b)
        poses[inner] = poses[inner] @ sim3.retract((to_row @ gain) @ error)
        by_b = to_row @ gain
        by_a = motions.adjoint(inner, a) - by_b @ motions.adjoint(b, a)
        both = np.concatenate([by_a, by_b], axis=2)
        alone = motions.covariance(a, inner) - by_b @ np.swapaxes(to_row @ with_end, 1, 2)
        spread[inner] = both @ joint[edge] @ np.swapaxes(both, 1, 2) + alone
    return poses, 0.5 * (spread + np.swapaxes(spread, 1, 2))
