"""Optimised graphs of poses against GTSAM, and against dense matrices."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from graphs import laps

from vo.base.types import Floats
from vo.engine.backend.chain_motion import motions_of
from vo.engine.backend.chain_reduction import ReducedGraph, reduce_graph
from vo.engine.backend.loop_edges import loop_edges
from vo.engine.backend.robust_graph import optimise
from vo.engine.backend.sparse_blocks import Couplings
from vo.engine.geometry import sim3


def _reduced(scale_sigma: float) -> tuple[Floats, ReducedGraph]:
    problem = laps(3, keyframes=120, per_lap=30, loops=25, scale_sigma=scale_sigma).problem
    motions = motions_of(problem)
    reduced = reduce_graph(problem, motions, loop_edges(problem))
    return motions.odom_from_cam[reduced.knots], reduced


def _similarity(a_from_b: Floats) -> gtsam.Similarity3:
    """GTSAM's form is s (R p + t)."""
    scale = float(sim3.scale_of(a_from_b))
    rotation = gtsam.Rot3(a_from_b[:3, :3] / scale)
    return gtsam.Similarity3(rotation, a_from_b[:3, 3] / scale, scale)


def _by_gtsam(start: Floats, reduced: ReducedGraph) -> tuple[Floats, gtsam.Marginals]:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    held = gtsam.noiseModel.Isotropic.Sigma(7, 1e-5)
    graph.add(gtsam.PriorFactorSimilarity3(0, _similarity(start[0]), held))
    for edges in (reduced.odometry, reduced.loops):
        for a, b, relation, covariance in zip(*edges, strict=True):
            noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
            between = _similarity(relation)
            graph.add(gtsam.BetweenFactorSimilarity3(int(a), int(b), between, noise))
    for n, pose in enumerate(start):
        values.insert(n, _similarity(pose))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-10)
    parameters.setAbsoluteErrorTol(1e-10)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    found = [values.atSimilarity3(n) for n in range(len(start))]
    centres = np.stack([each.scale() * each.translation() for each in found])
    return centres, gtsam.Marginals(graph, values)


@pytest.mark.parametrize("scale_sigma", [0.0, 0.005])
def test_poses_and_covariances_are_those_of_gtsam(scale_sigma: float) -> None:
    start, reduced = _reduced(scale_sigma)
    centres, marginals = _by_gtsam(start, reduced)
    found = optimise(start, np.array([0]), reduced.odometry, reduced.loops)
    moved = np.linalg.norm(centres - start[:, :3, 3], axis=1).max()
    assert moved > 0.1
    np.testing.assert_allclose(found.world_from[:, :3, 3], centres, rtol=0, atol=0.01 * moved)
    for n in range(1, len(start)):
        expected = marginals.marginalCovariance(n)
        np.testing.assert_allclose(found.single[n], expected, rtol=0, atol=0.01 * expected.max())
    for n, (i, j) in enumerate(zip(*reduced.odometry[:2], strict=True)):
        both = marginals.jointMarginalCovariance([int(i), int(j)])
        expected = np.block([[both.at(int(r), int(c)) for c in (i, j)] for r in (i, j)])
        np.testing.assert_allclose(found.joint[n], expected, rtol=0, atol=0.01 * expected.max())


@pytest.mark.parametrize("count", [2, 30])
def test_sparse_solutions_and_inverses_are_those_of_dense_matrices(count: int) -> None:
    rng = np.random.default_rng(count)
    a, b = np.arange(count - 1), np.arange(1, count)
    if count > 2:
        a, b = np.r_[a, 4, rng.integers(0, 15, 12)], np.r_[b, 4, rng.integers(15, count, 12)]
    jacobians = rng.normal(size=(len(a), 14, 14))
    terms = np.swapaxes(jacobians, 1, 2) @ jacobians
    dense = np.zeros((count, 7, count, 7))
    for n, ends in enumerate(zip(a, b, strict=True)):
        for row, at in enumerate(ends):
            for column, then in enumerate(ends):
                dense[at, :, then] += terms[n, 7 * row : 7 * row + 7, 7 * column : 7 * column + 7]
    couplings = Couplings(count, np.r_[a, b, a], np.r_[a, b, b])
    diagonal, across = rng.uniform(0.0, 1.0, (count, 7)), terms[:, :7, 7:]
    across[a == b] += np.swapaxes(across[a == b], 1, 2)
    matrix = couplings.matrix(np.concatenate([terms[:, :7, :7], terms[:, 7:, 7:], across]))
    whole = dense.reshape(7 * count, 7 * count) + np.diag(diagonal.ravel())
    right = rng.normal(size=(count, 7))
    expected = np.linalg.solve(whole, right.ravel()).reshape(count, 7)
    found, log_determinant = couplings.solve(matrix, diagonal, right)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(log_determinant, np.linalg.slogdet(whole)[1], rtol=1e-10)
    single, blocks = couplings.inverse_blocks(matrix, diagonal)
    inverse = np.linalg.inv(whole).reshape(count, 7, count, 7)
    for n in range(count):
        np.testing.assert_allclose(single[n], inverse[n, :, n], rtol=1e-6, atol=1e-9)
    for n, (i, j) in enumerate(zip(np.r_[a, b, a], np.r_[a, b, b], strict=True)):
        np.testing.assert_allclose(blocks[n], inverse[i, :, j], rtol=1e-6, atol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        couplings.solve(matrix, diagonal - 1e3, right)
