"""Many rotations at once."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.transforms import so3_exp, so3_log
from vo.engine.geometry import so3


def _rotvecs() -> np.ndarray:
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((40, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.r_[0.0, 1e-9, 1e-5, 9e-5, 1.1e-4, np.linspace(0.01, np.pi - 1e-6, 35)]
    return axes * angles[:, None]


def test_exp_and_log_are_those_of_single_rotations() -> None:
    rotvecs = _rotvecs()
    rotations = so3.exp(rotvecs)
    np.testing.assert_allclose(rotations, [so3_exp(v) for v in rotvecs], atol=1e-14)
    np.testing.assert_allclose(so3.log(rotations), [so3_log(r) for r in rotations], atol=1e-9)
    np.testing.assert_allclose(so3.log(rotations), rotvecs, atol=1e-9)


def test_log_of_half_turns_is_of_length_pi() -> None:
    for axis in (np.eye(3)[0], np.array([0.6, -0.8, 0.0]), np.ones(3) / np.sqrt(3.0)):
        found = so3.log(so3.exp(np.pi * axis)[None])[0]
        np.testing.assert_allclose(np.abs(found), np.pi * np.abs(axis), atol=1e-7)


@pytest.mark.parametrize("length", [0.0, 5e-5, 0.3, 2.5])
def test_jacobians_are_the_derivatives(length: float) -> None:
    rotvec = length * np.array([0.48, -0.6, 0.64])
    step = 1e-6 * np.eye(3)
    moved = so3.log(so3.exp(rotvec).T @ so3.exp(rotvec + step)) / 1e-6
    np.testing.assert_allclose(so3.right_jacobian(rotvec), moved.T, atol=2e-6)
    back = (so3.log(so3.exp(rotvec) @ so3.exp(step)) - rotvec) / 1e-6
    np.testing.assert_allclose(so3.inverse_right_jacobian(rotvec), back.T, atol=2e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 13])
def test_running_products_are_in_order(count: int) -> None:
    factors = so3.exp(np.random.default_rng(count).standard_normal((count, 3)))
    products = so3.running_products(factors)
    assert products.shape == (count + 1, 3, 3)
    expected = np.eye(3)
    for k in range(count):
        np.testing.assert_allclose(products[k], expected, atol=1e-13)
        expected = expected @ factors[k]
    np.testing.assert_allclose(products[-1], expected, atol=1e-13)
