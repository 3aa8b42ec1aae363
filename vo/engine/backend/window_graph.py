"""Factor graph of a window, optimised by GTSAM: with further factors, or where it is chosen.

The observations are one factor on all free poses, from which the landmarks are eliminated: with one
factor for each of some six thousand observations, building and linearising the graph takes GTSAM
about ten times as long for the same optimum (docs/experiments/one-factor-per-window.md). Further
factors of the window are added to the same graph.
"""

from __future__ import annotations

import gtsam
import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.types import Floats
from vo.engine.backend.bundle import Bundle, NormalEquations
from vo.engine.backend.window_problem import Gauge, WindowProblem

# Eigenvalue of the hessian, relative to the greatest, below which a direction is not determined.
_UNDETERMINED = 1e-13
_INITIAL_LAMBDA = 1e-4  # of Levenberg and Marquardt


class WindowGraph:
    """Factor graph of a window. Keys of poses are their rows.

    Held poses are no variables; only further factors need them in the graph, as constraints.
    """

    def __init__(self, problem: WindowProblem, gauge: Gauge, bundle: Bundle) -> None:
        self._problem = problem
        self._start = problem.world_from_cam
        self._free: list[int] = np.flatnonzero(~gauge.held).tolist()
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k in self._free:
            self._values.insert(k, gtsam.Pose3(self._start[k]))
        self._graph.add(self._bundle_factor(bundle))
        if gauge.scaled is not None:
            noise = gtsam.noiseModel.Diagonal.Sigmas(gauge.sigmas)
            pose = gtsam.Pose3(self._start[gauge.scaled])
            self._graph.add(gtsam.PriorFactorPose3(gauge.scaled, pose, noise))
        self._further = gtsam.NonlinearFactorGraph()
        self._add_factors(np.flatnonzero(gauge.held).tolist())

    def optimise(self, config: SmoothingConfig) -> gtsam.Values:
        """Minimise by Levenberg and Marquardt."""
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(config.iterations)
        parameters.setRelativeErrorTol(config.relative_error_tolerance)
        parameters.setlambdaInitial(_INITIAL_LAMBDA)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, self._values, parameters)
        return optimizer.optimize()

    def poses(self, values: gtsam.Values) -> Floats:
        """(K, 4, 4) poses, the held ones unchanged."""
        return _poses(self._start, self._free, values)

    def states(self, values: gtsam.Values) -> dict[int, Floats]:
        """Further states by key: vectors, or poses as (4, 4)."""
        keys = [key for key in _keys(values) if key >= len(self._start)]
        return {key: _state(values, key) for key in keys}

    def information(self, values: gtsam.Values) -> Floats | None:
        """(6 K, 6 K) of the further factors on the poses, their states eliminated."""
        if self._further.empty():
            return None
        count = len(self._start)
        keys = sorted(self._further.keyVector())  # poses first
        poses = [key for key in keys if key < count]
        ordering = gtsam.Ordering()
        for key in keys:
            ordering.push_back(key)
        hessian, _ = self._further.linearize(values).hessian(ordering)
        rows = np.concatenate([np.arange(6 * key, 6 * key + 6) for key in poses])
        information = np.zeros((6 * count, 6 * count))
        information[np.ix_(rows, rows)] = _schur_complement(np.asarray(hessian), len(rows))
        return information

    def _add_factors(self, held: list[int]) -> None:
        """Add the further factors, and the held poses that they may refer to."""
        exact = gtsam.noiseModel.Constrained.All(6)
        for k in held:
            pose = gtsam.Pose3(self._start[k])
            self._values.insert(k, pose)
            self._graph.add(gtsam.PriorFactorPose3(k, pose, exact))
        for factor in self._problem.factors:
            factor.add_to(self._further, self._values, int)
        self._graph.push_back(self._further)

    def _bundle_factor(self, bundle: Bundle) -> gtsam.CustomFactor:
        """All observations as one factor on the free poses; its squared error is the cost.

        It must not refer to this object, which has the graph with the factor: Python finds no
        cycles through GTSAM, and each window would stay in memory.
        """
        start, free = self._start, self._free
        rows = 6 * len(free) + 1

        def error(
            _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats] | None
        ) -> Floats:
            poses = _poses(start, free, values)
            if jacobians is None:
                length = np.sqrt(2.0 * bundle.cost(poses))
                return np.append(np.zeros(rows - 1), length)
            root, whitened = _square_root(bundle.normal_equations(poses))
            for i in range(len(free)):
                jacobians[i] = np.vstack([root[:, 6 * i : 6 * i + 6], np.zeros((1, 6))])
            return whitened

        return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), free, error)


def _poses(start: Floats, free: list[int], values: gtsam.Values) -> Floats:
    """(K, 4, 4) poses, those that are not free unchanged."""
    poses: Floats = start.copy()
    for k in free:
        poses[k] = values.atPose3(k).matrix()
    return poses


def _keys(values: gtsam.Values) -> list[int]:
    return list(values.keys())  # noqa: SIM118 (not a dict)


def _state(values: gtsam.Values, key: int) -> Floats:
    try:
        return np.asarray(values.atVector(key))
    except RuntimeError:  # GTSAM's way to say that it is of another type
        return np.asarray(values.atPose3(key).matrix())


def _schur_complement(hessian: Floats, size: int) -> Floats:
    """Information on the first `size` variables, the others eliminated."""
    kept, coupling, other = hessian[:size, :size], hessian[:size, size:], hessian[size:, size:]
    return np.asarray(kept - coupling @ np.linalg.pinv(other, hermitian=True) @ coupling.T)


def _square_root(normal: NormalEquations) -> tuple[Floats, Floats]:
    """Jacobian J (6 F + 1, 6 F) without its zero last row, and errors e (6 F + 1,).

    J^T J is the hessian of the poses, J^T e[:-1] their gradient; the last error, which no pose
    changes, makes half the sum of squares the cost. By eigenvalues, as the hessian may leave a
    direction undetermined: in mono the scale.
    """
    values, vectors = np.linalg.eigh(normal.hessian)
    determined = values > _UNDETERMINED * values[-1]
    root = np.where(determined, np.sqrt(np.maximum(values, 0.0)), 0.0)
    with np.errstate(divide="ignore"):
        inverse_root = np.where(determined, 1.0 / root, 0.0)
    error = np.asarray(inverse_root * (vectors.T @ normal.gradient), dtype=np.float64)
    constant = np.sqrt(max(2.0 * normal.cost - float(error @ error), 0.0))  # no pose changes it
    return root[:, None] * vectors.T, np.r_[error, constant]
