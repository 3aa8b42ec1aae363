"""Covariances of a graph of poses against those that GTSAM computes one by one."""

from __future__ import annotations

import gtsam
import numpy as np
from graphs import laps

from vo.engine.backend.chain_motion import ChainMotions
from vo.engine.backend.chain_reduction import reduce_graph
from vo.engine.backend.graph_marginals import pose_covariances
from vo.engine.backend.loop_edges import loop_edges
from vo.engine.backend.robust_graph import _add, _graph, _values


def test_covariances_are_those_of_gtsam() -> None:
    problem = laps(3, keyframes=120, per_lap=30, loops=25, scale_sigma=0.005).problem
    motions, loops = ChainMotions(problem), loop_edges(problem)
    reduced = reduce_graph(problem, motions, loops)
    start = motions.odom_from_cam[reduced.knots]
    graph, values = _graph(start, np.array([0]), reduced.odometry), _values(start)
    _add(graph, reduced.loops)
    a = np.concatenate([reduced.odometry.a, reduced.loops.b])
    b = np.concatenate([reduced.odometry.b, reduced.loops.a])
    single, pairs = pose_covariances(graph, values, a, b)
    expected = gtsam.Marginals(graph, values)
    for n in range(len(start)):
        np.testing.assert_allclose(
            single[n], expected.marginalCovariance(n), rtol=1e-6, atol=1e-9 * single[n].max()
        )
    for n, (i, j) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        joint = expected.jointMarginalCovariance([i, j])
        blocks = [[joint.at(row, column) for column in (i, j)] for row in (i, j)]
        np.testing.assert_allclose(
            pairs[n], np.block(blocks), rtol=1e-6, atol=1e-9 * pairs[n].max()
        )


def test_a_graph_of_one_pose_has_no_pairs() -> None:
    start, none = np.eye(4)[None], np.zeros(0, np.int64)
    problem = laps(0, keyframes=2, loops=0).problem
    odometry = reduce_graph(problem, ChainMotions(problem), loop_edges(problem)).odometry
    assert len(odometry.a) == 0
    graph = _graph(start, np.array([0]), odometry)
    single, pairs = pose_covariances(graph, _values(start), none, none)
    assert single.shape == (1, 7, 7) and pairs.shape == (0, 14, 14)
