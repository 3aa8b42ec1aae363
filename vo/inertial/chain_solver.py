"""Linear least squares on a chain of states: block-tridiagonal normal equations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.types import Floats


class Equations(NamedTuple):
    """Normal equations H x = -g of a chain, whose terms join neighbours only.

    Attributes:
        before: (n, d, d) part of H[k, k] by terms with no later state.
        after: (n, d, d) part of H[k, k] by terms with the next state.
        coupling: (n - 1, d, d) H[k, k + 1].
        gradient_before: (n, d) part of g[k], as of H.
        gradient_after: (n, d).
    """

    before: Floats
    after: Floats
    coupling: Floats
    gradient_before: Floats
    gradient_after: Floats


class ChainSolution(NamedTuple):
    """Solution of normal equations.

    Attributes:
        step: (n, d).
        covariance: (n, d, d) of each state.
        reduced: (n, d, d) information on each state by all terms without a later one.
        reduced_gradient: (n, d) the same of the gradient.
    """

    step: Floats
    covariance: Floats
    reduced: Floats
    reduced_gradient: Floats


def empty_equations(count: int, width: int) -> Equations:
    """Equations without terms."""
    blocks, gradients = np.zeros((3, count, width, width)), np.zeros((2, count, width))
    return Equations(blocks[0], blocks[1], blocks[2, 1:], gradients[0], gradients[1])


def solve_chain(equations: Equations) -> ChainSolution:
    """Solve by elimination from the first state to the last.

    Raises:
        numpy.linalg.LinAlgError: some direction is not determined.

    Source: Särkkä, "Bayesian Filtering and Smoothing", 2013, sec. 8.2 (the recursions backwards
    give the marginal covariances).
    """
    reduced, right = equations.before.copy(), equations.gradient_before.copy()
    coupling = equations.coupling
    count, width = right.shape
    gains, inverses = np.empty_like(coupling), np.empty_like(reduced)
    for k in range(count):
        whole = reduced[k] + equations.after[k]
        inverses[k] = _inverse(whole)
        if k + 1 < count:
            gains[k] = inverses[k] @ coupling[k]
            reduced[k + 1] -= coupling[k].T @ gains[k]
            right[k + 1] -= gains[k].T @ (right[k] + equations.gradient_after[k])
    step, covariance = np.zeros((count, width)), inverses.copy()
    for k in range(count - 1, -1, -1):
        step[k] = -inverses[k] @ (right[k] + equations.gradient_after[k])
        if k + 1 < count:
            step[k] -= gains[k] @ step[k + 1]
            covariance[k] += gains[k] @ covariance[k + 1] @ gains[k].T
    return ChainSolution(step, covariance, reduced, right)


def _inverse(matrix: Floats) -> Floats:
    """Inverse of a positive definite matrix, by a scaling that equalises its units.

    Raises:
        numpy.linalg.LinAlgError: it is not positive definite.
    """
    scale = np.diag(matrix).copy()
    if not (scale > 0).all():
        raise np.linalg.LinAlgError("not positive definite")
    scale = 1.0 / np.sqrt(scale)
    scaled = matrix * scale[:, None] * scale
    lower = np.linalg.inv(np.linalg.cholesky(0.5 * (scaled + scaled.T)))
    return np.asarray((lower.T @ lower) * scale[:, None] * scale)
