"""Normal equations of a chain of states."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.types import Floats
from vo.engine.inertial.chain_solver import Equations, empty_equations, solve_chain

_COUNT, _WIDTH = 5, 4


def _equations() -> Equations:
    """Random terms of single states and of neighbours, with units that differ by 10^6."""
    rng = np.random.default_rng(3)
    units = np.logspace(-3.0, 3.0, _WIDTH)
    equations = empty_equations(_COUNT, _WIDTH)
    for k in range(_COUNT):
        alone = rng.normal(size=(6, _WIDTH)) * units
        equations.before[k] += alone.T @ alone
        equations.gradient_before[k] = rng.normal(size=_WIDTH) * units
    for k in range(_COUNT - 1):
        first, second = rng.normal(size=(2, 7, _WIDTH)) * units
        equations.after[k] = first.T @ first
        equations.before[k + 1] += second.T @ second
        equations.coupling[k] = first.T @ second
        equations.gradient_after[k] = rng.normal(size=_WIDTH) * units
    return equations


def _dense(equations: Equations) -> tuple[Floats, Floats]:
    """The same as one matrix and one vector."""
    matrix = np.zeros((_COUNT * _WIDTH, _COUNT * _WIDTH))
    for k in range(_COUNT):
        at = slice(k * _WIDTH, (k + 1) * _WIDTH)
        matrix[at, at] = equations.before[k] + equations.after[k]
        if k + 1 < _COUNT:
            following = slice(at.stop, at.stop + _WIDTH)
            matrix[at, following] = equations.coupling[k]
            matrix[following, at] = equations.coupling[k].T
    return matrix, (equations.gradient_before + equations.gradient_after).ravel()


def test_solution_is_that_of_the_dense_equations() -> None:
    equations = _equations()
    matrix, gradient = _dense(equations)
    inverse = np.linalg.inv(matrix)

    found = solve_chain(equations)

    scale = np.sqrt(np.diag(inverse)).reshape(_COUNT, _WIDTH)
    expected = -(inverse @ gradient).reshape(_COUNT, _WIDTH)
    np.testing.assert_allclose(found.step / scale, expected / scale, atol=1e-9)
    for k in range(_COUNT):
        at = slice(k * _WIDTH, (k + 1) * _WIDTH)
        units = np.outer(scale[k], scale[k])
        np.testing.assert_allclose(found.covariance[k] / units, inverse[at, at] / units, atol=1e-9)


def test_what_is_known_of_the_last_state_comes_from_all_before() -> None:
    equations = _equations()
    found = solve_chain(equations)
    last = np.linalg.inv(found.reduced[-1])
    np.testing.assert_allclose(last, found.covariance[-1], rtol=1e-9)
    np.testing.assert_allclose(-last @ found.reduced_gradient[-1], found.step[-1], rtol=1e-9)


def test_a_direction_that_nothing_determines_is_an_error() -> None:
    equations = _equations()
    for part in (equations.before, equations.after, equations.coupling):
        part[:, 1], part[:, :, 1] = 0.0, 0.0
    with pytest.raises(np.linalg.LinAlgError):
        solve_chain(equations)
