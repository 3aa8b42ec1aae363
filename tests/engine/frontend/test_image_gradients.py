"""Means of products in windows, against OpenCV's box filter."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.engine.frontend.image_gradients import mean_product


@pytest.mark.parametrize("shape", [(4, 4), (5, 31), (40, 7), (120, 161)])
def test_means_are_those_of_a_box_filter_with_mirrored_borders(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(0).normal(0.0, 10.0, (4, *shape)).astype(np.float32)
    u, v, other_u, other_v = values
    expected = cv2.boxFilter(u * other_u + v * other_v, -1, (7, 7))
    found = mean_product(u, v, other_u, other_v)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 2), (3, 3)])
def test_means_of_images_smaller_than_the_window_are_finite(shape: tuple[int, int]) -> None:
    u = np.full(shape, 2.0, np.float32)
    assert np.isfinite(mean_product(u, u, u, u)).all()
