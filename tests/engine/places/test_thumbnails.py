"""Thumbnails of images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.engine.places.thumbnails import thumbnail_of


@pytest.mark.parametrize("shape", [(370, 1226), (480, 752), (121, 40), (241, 1), (120, 333)])
def test_a_thumbnail_has_the_mean_of_each_area(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    size = max(1, round(shape[1] * 120 / shape[0])), 120
    expected = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(int)
    difference = np.abs(thumbnail_of(image) - expected)
    assert difference.max() <= 1  # means between two grey levels are rounded either way
    assert np.count_nonzero(difference) < 0.005 * difference.size


def test_a_small_image_is_its_own_thumbnail() -> None:
    image = np.arange(12 * 7, dtype=np.uint8).reshape(12, 7)
    assert np.array_equal(thumbnail_of(image), image)
