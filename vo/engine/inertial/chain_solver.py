"""Linear least squares on a chain of states: block-tridiagonal normal equations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats


class Equations(NamedTuple):
    """Normal equations H x = -g of a chain, whose terms join neighbours only."""

    before: Floats  # (n, d, d) part of H[k, k] by terms with no later state
    after: Floats  # (n, d, d) part of H[k, k] by terms with the next state
    coupling: Floats  # (n - 1, d, d) H[k, k + 1]
    gradient_before: Floats  # (n, d) part of g[k], as of H
    gradient_after: Floats  # (n, d)


class ChainSolution(NamedTuple):
    """Solution of normal equations."""

    step: Floats  # (n, d)
    covariance: Floats  # (n, d, d) of each state
    reduced: Floats  # (n, d, d) information on each state by all terms without a later one
    reduced_gradient: Floats  # (n, d) the same of the gradient


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
    parts = equations.before, equations.after, equations.coupling
    gradients = equations.gradient_before, equations.gradient_after
    is_determined, *solution = _solved(*(np.ascontiguousarray(a) for a in (*parts, *gradients)))
    if not is_determined:
        raise np.linalg.LinAlgError("not positive definite")
    return ChainSolution(*solution)


@compiled
def _solved(before, after, coupling, gradient_before, gradient_after):  # type: ignore[no-untyped-def]
    """Whether the equations determine all states, and the fields of `ChainSolution`."""
    count, width = gradient_before.shape
    reduced, right = before.copy(), gradient_before.copy()
    covariance, step = np.zeros(before.shape), np.zeros((count, width))
    gains = np.zeros(coupling.shape)
    whole, lower = np.empty((width, width)), np.empty((width, width))
    carried, scale = np.empty((width, width)), np.empty(width)
    for k in range(count):
        for i in range(width):
            for j in range(width):
                whole[i, j] = reduced[k, i, j] + after[k, i, j]
        if not invert_into(whole, scale, lower, covariance[k]):
            return False, step, covariance, reduced, right
        if k + 1 < count:
            add_product(covariance[k], coupling[k], gains[k])
            for i in range(width):
                for m in range(width):
                    for j in range(width):
                        reduced[k + 1, m, j] -= coupling[k, i, m] * gains[k, i, j]
                for m in range(width):
                    right[k + 1, m] -= gains[k, i, m] * (right[k, i] + gradient_after[k, i])
    for k in range(count - 1, -1, -1):
        for i in range(width):
            for j in range(width):
                step[k, i] -= covariance[k, i, j] * (right[k, j] + gradient_after[k, j])
        if k + 1 < count:
            for i in range(width):
                for j in range(width):
                    step[k, i] -= gains[k, i, j] * step[k + 1, j]
                    carried[i, j] = 0.0
                    whole[j, i] = gains[k, i, j]
            add_product(gains[k], covariance[k + 1], carried)
            add_product(carried, whole, covariance[k])
    return True, step, covariance, reduced, right


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def add_product(a, b, result):  # type: ignore[no-untyped-def]
    """Add the product of two square matrices."""
    for i in range(len(a)):
        for k in range(len(a)):
            factor = a[i, k]
            for j in range(len(a)):
                result[i, j] += factor * b[k, j]


@compiled(**NO_REFCOUNT)
def invert_into(matrix, scale, lower, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a positive definite matrix, by a scaling that equalises its units.

    `matrix`, `scale` and `lower` are changed. Whether it is positive definite.
    """
    width = len(matrix)
    for i in range(width):
        if not matrix[i, i] > 0.0:
            return False
        scale[i] = 1.0 / np.sqrt(matrix[i, i])
    for i in range(width):  # Cholesky
        for j in range(i + 1):
            rest = 0.5 * (matrix[i, j] + matrix[j, i]) * scale[i] * scale[j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = rest / lower[j, j]
            elif rest > 0.0:
                lower[i, i] = np.sqrt(rest)
            else:
                return False
    for j in range(width):  # its inverse, in `matrix`
        for i in range(j, width):
            rest = 1.0 if i == j else 0.0
            for k in range(j, i):
                rest -= lower[i, k] * matrix[k, j]
            matrix[i, j] = rest / lower[i, i]
    for i in range(width):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, width):
                total += matrix[k, i] * matrix[k, j]
            inverse[i, j] = inverse[j, i] = total * scale[i] * scale[j]
    return True
