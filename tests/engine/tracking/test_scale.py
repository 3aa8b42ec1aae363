"""Length of a translation from points of the map."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.transforms import se3_exp, transform_points
from vo.base.types import Floats
from vo.engine.tracking.essential_matrix import scale_from_points


def _step(length: float) -> tuple[Floats, Floats, Floats]:
    """A motion of unit length, points before it and their rays after a step of `length`."""
    rng = np.random.default_rng(0)
    unit = se3_exp(np.array([0.02, -0.03, 0.01, 0.0, 0.0, 0.0]))
    unit[:3, 3] = np.array([0.6, -0.1, -0.79]) / np.linalg.norm([0.6, -0.1, -0.79])
    points = rng.uniform((-4, -3, 4), (4, 3, 20), (80, 3))
    motion = unit.copy()
    motion[:3, 3] *= length
    moved = transform_points(motion, points)
    return unit, points, moved[:, :2] / moved[:, 2:]


@pytest.mark.parametrize("length", [0.01, 0.3, 2.5])
def test_the_scale_is_exact_without_noise(length: float) -> None:
    scale, support = scale_from_points(*_step(length))
    assert scale == pytest.approx(length, rel=1e-9)
    assert support == 80


def test_the_scale_survives_outliers_and_noise() -> None:
    unit, points, rays = _step(0.5)
    rng = np.random.default_rng(1)
    rays = rays + rng.normal(0, 0.0005, rays.shape)
    rays[:20] += rng.uniform(-0.3, 0.3, (20, 2))
    scale, support = scale_from_points(unit, points, rays)
    assert scale == pytest.approx(0.5, rel=0.05)
    assert 50 <= support <= 70


def test_points_that_move_the_other_way_support_no_scale() -> None:
    scale, support = scale_from_points(*_step(-0.5))
    assert scale <= 0
    assert support == 0


def test_no_points_support_no_scale() -> None:
    unit, points, rays = _step(0.5)
    assert scale_from_points(unit, points[:0], rays[:0]) == (0.0, 0)


def test_points_in_the_direction_of_motion_say_nothing_of_the_scale() -> None:
    unit = np.eye(4)
    unit[2, 3] = -1.0
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 9.0]])
    assert scale_from_points(unit, points, np.zeros((2, 2))) == (0.0, 0)
