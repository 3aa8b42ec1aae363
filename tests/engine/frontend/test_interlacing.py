"""Interlaced images, and others that alternate from row to row."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.faults import FaultKind
from vo.base.types import Bytes
from vo.engine.frontend.image_faults import ImageFaults, share_of_combs

CLEAN_SHARE, LEAST_SHARE = 0.0, 0.02


def scene(seed: int = 3) -> Bytes:
    """Rectangles of all sizes, with a little noise."""
    rng = np.random.default_rng(seed)
    image = np.full((300, 400), 120, np.uint8)
    for _ in range(400):
        x, y, size = (int(v) for v in rng.integers((0, 0, 3), (400, 300, 40)))
        grey = int(rng.integers(0, 256))
        cv2.rectangle(image, (x, y), (x + size, y + size // 2), grey, -1)
    return noisy(np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.uint8), 2.0)


def noisy(image: Bytes, sigma: float) -> Bytes:
    rng = np.random.default_rng(1)
    return (image + rng.normal(0, sigma, image.shape)).clip(0, 255).astype(np.uint8)


def interlaced(image: Bytes, motion_px: int) -> Bytes:
    """Odd rows taken when the scene had moved."""
    result = image.copy()
    result[1::2] = np.roll(image, motion_px, axis=1)[1::2]
    return result


def compressed(image: Bytes, quality: int) -> Bytes:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


@pytest.mark.parametrize("motion_px", [1, 2, 4, 12, -6])
def test_interlaced_images_have_combs(motion_px: int) -> None:
    image = interlaced(scene(), motion_px)
    assert share_of_combs(image) > LEAST_SHARE
    assert share_of_combs(compressed(image, 50)) > LEAST_SHARE


def test_combs_are_seen_through_noise() -> None:
    assert share_of_combs(noisy(interlaced(scene(), 6), 10.0)) > LEAST_SHARE


@pytest.mark.parametrize("sigma", [0.0, 5.0, 15.0, 40.0])
def test_noise_makes_no_combs(sigma: float) -> None:
    assert share_of_combs(noisy(scene(), sigma)) == CLEAN_SHARE
    assert share_of_combs(noisy(np.full((300, 400), 128, np.uint8), sigma)) == CLEAN_SHARE


def test_fine_texture_makes_no_combs() -> None:
    small = scene()[::2, ::2]  # aliased
    checkers = (np.indices((300, 400)).sum(axis=0) % 2 * 100 + 50).astype(np.uint8)
    mosaic = scene().copy()  # of a colour camera, whose filters differ in brightness
    mosaic[::2, ::2] //= 2
    mosaic[1::2, 1::2] //= 3
    for image in (small, checkers, mosaic, compressed(scene(), 20)):
        assert share_of_combs(image) == CLEAN_SHARE


@pytest.mark.parametrize("shape", [(1, 1), (4, 300), (300, 4), (5, 5)])
def test_tiny_images_have_no_combs(shape: tuple[int, int]) -> None:
    assert share_of_combs(np.zeros(shape, np.uint8)) == CLEAN_SHARE


def test_two_of_the_images_examined_make_a_fault() -> None:
    clean, combed = scene(), interlaced(scene(), 6)
    detector = ImageFaults()
    found = []
    for image in [combed] * 6 + [clean] * 20:
        detector.update(image)
        found.append(bool(detector.faults))
    assert found == [False] * 4 + [True] * 16 + [False] * 6


def test_the_fault_is_not_handled() -> None:
    detector = ImageFaults()
    for _ in range(5):
        detector.update(interlaced(scene(), 6))
    (fault,) = detector.faults
    assert fault.kind is FaultKind.INTERLACED_IMAGES and not fault.is_handled
    assert fault.value == share_of_combs(interlaced(scene(), 6))


def test_film_with_pulldown_is_interlaced() -> None:
    """Two of five frames are woven from two images of the film."""
    clean, combed = scene(), interlaced(scene(), 6)
    detector = ImageFaults()
    for i in range(40):
        detector.update(combed if i % 5 < 2 else clean)
        assert bool(detector.faults) == (i >= 16)


def test_a_single_combed_image_is_no_fault() -> None:
    detector = ImageFaults()
    for i in range(40):
        detector.update(interlaced(scene(), 6) if i == 8 else scene())
        assert not detector.faults
