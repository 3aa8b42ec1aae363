"""Robust optimisation of a reduced pose graph with GTSAM: true loops, poses, covariances."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.graph_marginals import pose_covariances
from vo.engine.backend.graph_problem import Edges
from vo.engine.backend.loop_edges import squared_distance
from vo.engine.geometry import sim3

# Squared Mahalanobis distance of seven numbers that one true loop in 1,000 exceeds.
_INLIER = 24.3
_GNC_STEPS, _GNC_FACTOR = 40, 1.4  # rounds, and the growth of the control parameter
_STEPS_EACH = 4  # steps of Levenberg-Marquardt in a round
_ITERATIONS = 50
_MAX_MARGINALS = 600  # poses up to which covariances are computed: some 2 s, 140 MB
_GAUGE_SIGMA = 1e-5  # of the first pose, which stays where it is


class OptimisedPoses(NamedTuple):
    """Poses (m, 4, 4), covariances of single ones, and (E, 14, 14) of edges of odometry.

    Attributes:
        single: (m, 7, 7) covariances of the poses, each in its own frame; NaN if they are too many.
    """

    world_from: Floats
    single: Floats
    joint: Floats


def keep_true_loops(start: Floats, gauge: Ints, odometry: Edges, loops: Edges) -> Bools:
    """(L,) loops that are inliers; odometry is known to be true.

    The limit of residuals shrinks from the largest one to that of an inlier, and all poses follow,
    from `start` (m, 4, 4); those of `gauge`, one of each connected part, stay.
    `gtsam.GncLMOptimizer` does the same, but begins anew from the first guess each time.

    Source: Yang et al., "Graduated Non-Convexity for Robust Spatial Perception", RA-L 2020, with
        truncated least squares; equation numbers stand beside the lines.
    """
    known = _graph(start, gauge, odometry)
    weights = np.ones(len(loops.a))
    values = _improved(known, loops, weights, _values(start))
    squared = _squared_residuals(values, loops)
    if squared.max(initial=0.0) <= _INLIER:
        return weights > 0.5
    control = _INLIER / (2.0 * squared.max() - _INLIER)  # remark 5
    for _ in range(_GNC_STEPS):
        low, high = control / (control + 1.0) * _INLIER, (control + 1.0) / control * _INLIER
        between = np.sqrt(_INLIER * control * (control + 1.0) / np.maximum(squared, low)) - control
        weights = np.where(squared <= low, 1.0, np.where(squared >= high, 0.0, between))  # (14)
        if np.isin(weights, (0.0, 1.0)).all():
            break
        values = _improved(known, loops, weights, values)
        squared = _squared_residuals(values, loops)
        control *= _GNC_FACTOR
    return weights > 0.5


def _improved(
    known: gtsam.NonlinearFactorGraph, loops: Edges, weights: Floats, values: gtsam.Values
) -> gtsam.Values:
    """Poses after a few steps with weighted loops."""
    graph = known.clone()
    used = weights > 1e-9
    weaker = loops.covariance[used] / weights[used, None, None]
    _add(graph, Edges(loops.a[used], loops.b[used], loops.a_from_b[used], weaker))
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(_STEPS_EACH)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


def _squared_residuals(values: gtsam.Values, loops: Edges) -> Floats:
    """(L,) squared Mahalanobis distances of the loops."""
    poses = _poses(values)
    error = sim3.local(sim3.inverse(loops.a_from_b) @ sim3.inverse(poses[loops.a]) @ poses[loops.b])
    return squared_distance(error, loops.covariance)


def optimise(start: Floats, gauge: Ints, odometry: Edges, loops: Edges) -> OptimisedPoses:
    """Least-squares poses with all relations; arguments as for `keep_true_loops`."""
    graph = _graph(start, gauge, odometry)
    _add(graph, loops)
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(_ITERATIONS)
    values = gtsam.LevenbergMarquardtOptimizer(graph, _values(start), params).optimize()
    world_from = _poses(values)
    if len(start) > _MAX_MARGINALS:
        unknown = np.full((len(start), 7, 7), np.nan)
        return OptimisedPoses(world_from, unknown, np.full((len(odometry.a), 14, 14), np.nan))
    return OptimisedPoses(world_from, *pose_covariances(graph, values, odometry.a, odometry.b))


def _graph(start: Floats, gauge: Ints, odometry: Edges) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    fixed = gtsam.noiseModel.Isotropic.Sigma(7, _GAUGE_SIGMA)
    for n in gauge.tolist():
        graph.add(gtsam.PriorFactorSimilarity3(n, _similarity(start[n]), fixed))
    _add(graph, odometry)
    return graph


def _add(graph: gtsam.NonlinearFactorGraph, edges: Edges) -> None:
    for a, b, relation, covariance in zip(*edges, strict=True):
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.BetweenFactorSimilarity3(int(a), int(b), _similarity(relation), noise))


def _values(world_from: Floats) -> gtsam.Values:
    values = gtsam.Values()
    for n, pose in enumerate(world_from):
        values.insert(n, _similarity(pose))
    return values


def _poses(values: gtsam.Values) -> Floats:
    return np.stack([_matrix(values.atSimilarity3(n)) for n in range(values.size())])


def _similarity(a_from_b: Floats) -> gtsam.Similarity3:
    """GTSAM's form is s (R p + t)."""
    scale = float(sim3.scale_of(a_from_b))
    rotation = gtsam.Rot3(a_from_b[:3, :3] / scale)
    return gtsam.Similarity3(rotation, a_from_b[:3, 3] / scale, scale)


def _matrix(a_from_b: gtsam.Similarity3) -> Floats:
    result = np.eye(4)
    result[:3, :3] = a_from_b.scale() * a_from_b.rotation().matrix()
    result[:3, 3] = a_from_b.scale() * a_from_b.translation()
    return result
