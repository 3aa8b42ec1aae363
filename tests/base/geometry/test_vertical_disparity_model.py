from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from vo.base.geometry.vertical_disparity_model import (
    FittedVerticalDisparity,
    VerticalDisparity,
    VerticalDisparityFit,
    sigmas_px,
)
from vo.base.types import Bools, Floats

FOCAL = 450.0
FOUND = VerticalDisparity(pitch_px=-1.5, roll_px=0.8, zoom_px=0.6, bend_px=-0.3, skew_px=2.0)


def _places(count: int, seed: int = 0) -> tuple[Floats, Floats]:
    x, y = np.random.default_rng(seed).uniform((-0.8, -0.5), (0.8, 0.5), (count, 2)).T
    return x, y


def _disparity_px(x: Floats, y: Floats) -> Floats:
    """That of a road, and of walls beside it at random distances."""
    walls = np.random.default_rng(4).uniform(2.0, 25.0, len(x))
    return np.where((y > 0.0) & (np.abs(x) < 0.5), 100.0 * y, walls)


def _fitted(x: Floats, y: Floats, vertical_px: Floats) -> tuple[FittedVerticalDisparity, Bools]:
    fit = VerticalDisparityFit()
    agrees = fit.add(x, y, vertical_px, _disparity_px(x, y))
    return fit.result(), agrees


def test_errors_are_recovered() -> None:
    x, y = _places(2000)
    fitted, agrees = _fitted(x, y, FOUND.vertical_px(x, y))
    # What is usual pulls a little, bend most.
    assert fitted.errors == pytest.approx(FOUND, abs=0.05)
    assert agrees.all()


def test_the_direction_of_the_baseline_is_not_taken_for_zoom() -> None:
    x, y = _places(1000)
    tilt_px = np.radians(0.5) * _disparity_px(x, y)
    noise = 0.1 * np.random.default_rng(5).standard_normal(len(x))
    fitted, _ = _fitted(x, y, FOUND.vertical_px(x, y) + tilt_px + noise)
    assert fitted.errors == pytest.approx(FOUND, abs=0.15)


def test_a_third_of_wrong_matches_changes_little() -> None:
    rng = np.random.default_rng(1)
    x, y = _places(900)
    rows = FOUND.vertical_px(x, y) + 0.1 * rng.standard_normal(len(x))
    rows[:300] = rng.uniform(-20.0, 20.0, 300)
    fitted, agrees = _fitted(x, y, rows)
    corner = np.array([0.8]), np.array([0.5])
    assert fitted.errors.vertical_px(*corner) == pytest.approx(FOUND.vertical_px(*corner), abs=0.15)
    assert agrees[300:].mean() > 0.95
    assert agrees[:300].mean() < 0.1


def test_uncertainty_is_higher_where_there_are_no_points() -> None:
    x, y = _places(300)
    left = x < 0.0
    fitted, _ = _fitted(x[left], y[left], FOUND.vertical_px(x[left], y[left]))
    (on_left, on_right), *_ = sigmas_px(
        fitted.covariance, np.array([-0.4, 0.8]), np.array([0.2, 0.2])
    )
    assert on_right > 3.0 * on_left > 0.0


def test_a_second_pair_with_points_elsewhere_reduces_the_uncertainty() -> None:
    x, y = _places(600)
    fit, corner = VerticalDisparityFit(), (np.array([0.8]), np.array([0.4]))
    near = _disparity_px(x, y)
    fit.add(x[x < 0], y[x < 0], FOUND.vertical_px(x[x < 0], y[x < 0]), near[x < 0])
    (before,), *_ = sigmas_px(fit.result().covariance, *corner)
    fit.add(x[x > 0], y[x > 0], FOUND.vertical_px(x[x > 0], y[x > 0]), near[x > 0])
    (after,), *_ = sigmas_px(fit.result().covariance, *corner)
    assert after < 0.5 * before
    assert fit.result().errors.vertical_px(*corner) == pytest.approx(
        FOUND.vertical_px(*corner), abs=0.05
    )


def test_a_fit_supports_a_pair_with_the_same_error_and_no_other() -> None:
    x, y = _places(400)
    noise = 0.2 * np.random.default_rng(3).standard_normal((3, len(x)))
    fit = VerticalDisparityFit()
    fit.add(x, y, FOUND.vertical_px(x, y) + noise[0], _disparity_px(x, y))
    assert fit.support(x, y, FOUND.vertical_px(x, y) + noise[1]) > 4.0
    assert fit.support(x, y, noise[2]) < 0.0


def _turned(axis: tuple[float, float, float]) -> Callable[[Floats], Floats]:
    """Rays as a camera sees them that is turned by a thousandth about an axis."""
    rotation, _ = cv2.Rodrigues(1e-3 * np.array(axis))
    return lambda rays: np.asarray(rays @ np.asarray(rotation, dtype=np.float64))


@pytest.mark.parametrize(
    ("change", "errors"),
    [
        (_turned((1.0, 0.0, 0.0)), VerticalDisparity(pitch_px=1e-3 * FOCAL)),
        (_turned((0.0, 0.0, -1.0)), VerticalDisparity(roll_px=1e-3 * FOCAL)),
        (lambda rays: rays * (1.001, 1.001, 1.0), VerticalDisparity(zoom_px=1e-3 * FOCAL)),
    ],
    ids=["pitch", "roll", "zoom"],
)
def test_the_errors_are_those_of_a_camera_that_was_moved(
    change: Callable[[Floats], Floats], errors: VerticalDisparity
) -> None:
    x, y = _places(50)
    seen = change(np.column_stack([x, y, np.ones(len(x))]))
    moved = FOCAL * (seen[:, :2] / seen[:, 2:] - np.column_stack([x, y]))
    np.testing.assert_allclose(moved[:, 1], errors.vertical_px(x, y), atol=2e-3)
    np.testing.assert_allclose(moved[:, 0], errors.horizontal_px(x, y), atol=2e-3)


def test_yaw_of_the_camera_skews_the_rows() -> None:
    x, y = _places(50)
    seen = _turned((0.0, 1.0, 0.0))(np.column_stack([x, y, np.ones(len(x))]))
    moved = FOCAL * (seen[:, :2] / seen[:, 2:] - np.column_stack([x, y]))
    skew = _fitted(x, y, moved[:, 1])[0].errors.skew_px
    assert abs(skew) == pytest.approx(1e-3 * FOCAL, abs=0.02)
    # The disparity shrinks by as much on the axis, and more beside it.
    np.testing.assert_allclose(moved[:, 0], skew * (1.0 + x * x), atol=0.03)
