"""Rectification in vector instructions gives the bits of OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.geometry import remapping
from vo.base.geometry.rectification_maps import Maps
from vo.base.geometry.remapping import Remapping
from vo.base.types import Bytes

WIDTH, HEIGHT = 203, 131


def _maps(turn: tuple[float, float, float], zoom: float, k1: float, width: int = WIDTH) -> Maps:
    rotation, _ = cv2.Rodrigues(np.array(turn))
    matrix = np.array([[150.0, 0.0, WIDTH / 2], [0.0, 150.0, HEIGHT / 2], [0.0, 0.0, 1.0]])
    seen = matrix * np.array([[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]])
    lens, size = np.array([k1, 0.0, 0.0, 0.0]), (width, HEIGHT)
    first, second = cv2.initUndistortRectifyMap(matrix, lens, rotation, seen, size, cv2.CV_16SC2)
    return first, second


def _images(shape: tuple[int, int] = (HEIGHT, WIDTH)) -> list[Bytes]:
    random = np.random.default_rng(1)
    return [random.integers(0, 256, shape, dtype=np.uint8) for _ in range(12)]


@pytest.mark.parametrize(
    ("turn", "zoom", "k1"),
    [
        ((0.0, 0.0, 0.0), 1.0, 0.0),
        ((0.01, -0.02, 0.03), 0.95, -0.28),
        ((0.0, 0.0, 0.3), 1.0, -0.1),  # rows that cross more than two
        ((0.2, 0.3, 0.0), 0.6, 0.0),  # a third lies outside
        ((0.0, 0.0, 0.0), 0.4, 0.0),  # neighbours are 2.5 px apart
    ],
)
def test_images_have_the_bits_of_opencv(
    turn: tuple[float, float, float], zoom: float, k1: float
) -> None:
    maps = _maps(turn, zoom, k1)
    of_images = Remapping(maps)
    for image in _images():
        expected = cv2.remap(image, *maps, cv2.INTER_LINEAR)
        np.testing.assert_array_equal(of_images(image), expected)
    assert of_images._blocks is not None


@pytest.mark.parametrize("width", [7, 8, 17, 400])
def test_rectified_images_may_have_any_width(width: int) -> None:
    maps = _maps((0.0, 0.01, 0.0), 0.9, -0.1, width)
    of_images = Remapping(maps)
    for image in _images():
        expected = cv2.remap(image, *maps, cv2.INTER_LINEAR)
        np.testing.assert_array_equal(of_images(image), expected)


def test_images_of_another_size_are_left_to_opencv() -> None:
    maps = _maps((0.0, 0.01, 0.0), 0.9, -0.1)
    of_images = Remapping(maps)
    for image in [*_images(), *_images((40, 90)), *_images((2, 300))]:
        expected = cv2.remap(image, *maps, cv2.INTER_LINEAR)
        np.testing.assert_array_equal(of_images(image), expected)


def test_where_most_pixels_are_in_no_block_opencv_does_all() -> None:
    random = np.random.default_rng(2)
    whole = random.integers(0, 100, (200, 200, 2), dtype=np.int16)
    maps = whole, random.integers(0, 1024, (200, 200), dtype=np.uint16)
    of_images = Remapping(maps)
    for image in _images():
        np.testing.assert_array_equal(of_images(image), cv2.remap(image, *maps, cv2.INTER_LINEAR))
    assert of_images._blocks is None


def test_nothing_is_prepared_where_the_instructions_are_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remapping, "has_common_instructions", lambda: False)
    maps = _maps((0.0, 0.01, 0.0), 0.9, -0.1)
    of_images = Remapping(maps)
    for image in _images():
        np.testing.assert_array_equal(of_images(image), cv2.remap(image, *maps, cv2.INTER_LINEAR))
    assert of_images._blocks is None
