"""Robust optimisation of a reduced pose graph: true loops, poses, covariances."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.graph_problem import Edges
from vo.engine.backend.sparse_blocks import Couplings
from vo.engine.geometry import sim3
from vo.engine.geometry.levenberg_marquardt import Law, minimise

# Squared Mahalanobis distance of seven numbers that one true loop in 1,000 exceeds.
_INLIER = 24.3
_GNC_STEPS, _GNC_FACTOR = 40, 1.4  # rounds, and the growth of the control parameter
_LAW = Law(50, 1e-5, damping=1e-5, most=1e5, tries=20)
_EACH_ROUND = _LAW._replace(iterations=4)
_GAUGE_SIGMA = 1e-5  # of the first pose, which stays where it is


class OptimisedPoses(NamedTuple):
    """Poses (m, 4, 4), covariances of single ones, and (E, 14, 14) of edges of odometry.

    Attributes:
        single: (m, 7, 7) covariances of the poses, each in its own frame.
    """

    world_from: Floats
    single: Floats
    joint: Floats


def keep_true_loops(start: Floats, gauge: Ints, odometry: Edges, loops: Edges) -> Bools:
    """(L,) loops that are inliers; odometry is known to be true.

    The limit of residuals shrinks from the largest one to that of an inlier, and all poses follow,
    from `start` (m, 4, 4); those of `gauge`, one of each connected part, stay.

    Source: Yang et al., "Graduated Non-Convexity for Robust Spatial Perception", RA-L 2020, with
        truncated least squares; equation numbers stand beside the lines.
    """
    graph = _Graph(len(start), gauge, odometry, loops)
    poses = minimise(graph, start, _EACH_ROUND)
    squared = graph.squared(poses)[len(odometry.a) :]
    weights = np.ones(len(loops.a))
    if squared.max(initial=0.0) <= _INLIER:
        return weights > 0.5
    control = _INLIER / (2.0 * squared.max() - _INLIER)  # remark 5
    for _ in range(_GNC_STEPS):
        low, high = control / (control + 1.0) * _INLIER, (control + 1.0) / control * _INLIER
        between = np.sqrt(_INLIER * control * (control + 1.0) / np.maximum(squared, low)) - control
        weights = np.where(squared <= low, 1.0, np.where(squared >= high, 0.0, between))  # (14)
        if np.isin(weights, (0.0, 1.0)).all():
            break
        graph.weight[len(odometry.a) :] = weights
        poses = minimise(graph, poses, _EACH_ROUND)
        squared = graph.squared(poses)[len(odometry.a) :]
        control *= _GNC_FACTOR
    return weights > 0.5


def optimise(start: Floats, gauge: Ints, odometry: Edges, loops: Edges) -> OptimisedPoses:
    """Least-squares poses with all relations; arguments as for `keep_true_loops`."""
    graph = _Graph(len(start), gauge, odometry, loops)
    poses = minimise(graph, start, _LAW)
    single, joint = graph.covariances(poses)
    return OptimisedPoses(poses, single, joint[: len(odometry.a)])


class _Graph:
    """All poses as variables.

    Attributes:
        weight: (E,) of the edges, odometry before loops.
    """

    def __init__(self, count: int, gauge: Ints, odometry: Edges, loops: Edges) -> None:
        edges = Edges(*(np.concatenate(both) for both in zip(odometry, loops, strict=True)))
        self.weight = np.ones(len(edges.a))
        self._edges, self._back = edges, sim3.inverse(edges.a_from_b)
        self._information = np.linalg.inv(edges.covariance)
        a, b = edges.a, edges.b
        self._couplings = Couplings(count, np.r_[a, b, a], np.r_[a, b, b])
        self._held = np.zeros((count, 7))
        self._held[gauge] = _GAUGE_SIGMA**-2

    def squared(self, poses: Floats) -> Floats:
        """(E,) squared Mahalanobis distances of the edges."""
        error = self._errors(poses)
        return np.asarray(np.einsum("ei,eij,ej->e", error, self._information, error))

    def cost(self, state: Floats) -> float:
        """Half the weighted sum of squares."""
        return 0.5 * float(self.weight @ self.squared(state))

    def steps(self, state: Floats) -> Callable[[float], Floats]:
        """By all damping alike."""
        matrix, gradient = self._equations(state)
        return lambda damping: self._couplings.solve(matrix, self._held + damping, -gradient)[0]

    def moved(self, state: Floats, step: Floats) -> Floats:
        """The poses after a step (m, 7)."""
        return np.asarray(state @ sim3.retract(step))

    def covariances(self, poses: Floats) -> tuple[Floats, Floats]:
        """Of poses (m, 7, 7), and of both ends of each edge (E, 14, 14), in their own frames."""
        single, of_edges = self._couplings.inverse_blocks(self._equations(poses)[0], self._held)
        a, b, between = np.split(of_edges, 3)
        return single, np.block([[a, between], [np.swapaxes(between, 1, 2), b]])

    def _errors(self, poses: Floats) -> Floats:
        a, b = poses[self._edges.a], poses[self._edges.b]
        return sim3.local(self._back @ sim3.inverse(a) @ b)

    def _equations(self, poses: Floats) -> tuple[Floats, Floats]:
        a, b, _, _ = self._edges
        weighted = self.weight[:, None, None] * self._information
        by_b = (weighted @ self._errors(poses)[:, :, None])[:, :, 0]
        back = np.swapaxes(-sim3.adjoint(sim3.inverse(poses[b]) @ poses[a]), 1, 2)
        gradient = np.zeros((len(poses), 7))
        np.add.at(gradient, a, (back @ by_b[:, :, None])[:, :, 0])
        np.add.at(gradient, b, by_b)
        coupling = back @ weighted
        by_a = coupling @ np.swapaxes(back, 1, 2)
        coupling[a == b] += np.swapaxes(coupling[a == b], 1, 2)
        return self._couplings.matrix(np.concatenate([by_a, weighted, coupling])), gradient
