"""Images that repeat the one before, exactly or but for noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.types import Bytes
from vo.engine.frontend.image_repetition import (
    ImageChange,
    Repetition,
    RepetitionDetector,
    image_change,
    is_right_frozen,
)

RNG = np.random.default_rng(0)


def scene() -> Bytes:
    blocks = RNG.integers(40, 216, (30, 40)).astype(np.uint8)
    large = cv2.resize(blocks, (640, 480), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.GaussianBlur(large, None, 1), dtype=np.uint8)


def noisy(image: Bytes, sigma: float) -> Bytes:
    changed = np.rint(image + RNG.normal(0.0, sigma, image.shape))
    return np.asarray(changed.clip(0, 255), dtype=np.uint8)


def compressed(image: Bytes, quality: int) -> Bytes:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def test_a_copy_is_identical() -> None:
    image = scene()
    assert image_change(image, image.copy()) == ImageChange(Repetition.IDENTICAL, 0.0)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0, 4.0])
def test_noise_alone_makes_no_motion(sigma: float) -> None:
    image = scene()
    change = image_change(noisy(image, sigma), noisy(image, sigma))
    assert change.repetition is Repetition.SIMILAR
    assert abs(change.motion_px) < 0.06


def test_noise_and_compression_make_no_motion() -> None:
    image = scene()
    pair = [compressed(noisy(image, 1.0), 80) for _ in range(2)]
    assert image_change(*pair).repetition is Repetition.SIMILAR


@pytest.mark.parametrize("motion_px", [1, 3, 20])
def test_motion_is_a_change(motion_px: int) -> None:
    image = scene()
    change = image_change(noisy(image, 2.0), noisy(np.roll(image, motion_px, axis=1), 2.0))
    assert change.repetition is Repetition.NONE
    assert motion_px > 3 or change.motion_px > 0.4  # what has little in common tells no motion


def test_images_without_edges_show_nothing() -> None:
    black = np.zeros((480, 640), np.uint8)
    assert image_change(black, black.copy()).repetition is Repetition.NONE
    assert image_change(noisy(black, 2.0), noisy(black, 2.0)).repetition is Repetition.NONE


def test_unequal_sizes_and_missing_images_are_no_repetition() -> None:
    image = scene()
    assert image_change(image, image[:200]).repetition is Repetition.NONE
    assert image_change(None, image).repetition is Repetition.NONE
    assert image_change(image[:5, :5], image[:5, :5]).repetition is Repetition.NONE


def test_the_detector_compares_each_camera_with_its_frame_before() -> None:
    left, right = scene(), scene()
    detector = RepetitionDetector()
    first = detector.update((left, right))
    second = detector.update((np.roll(left, 3, axis=1), right.copy()))
    assert [c.repetition for c in first] == [Repetition.NONE] * 2
    assert [c.repetition for c in second] == [Repetition.NONE, Repetition.IDENTICAL]
    assert is_right_frozen(*second) and not is_right_frozen(*first)


def test_a_right_image_that_differs_by_noise_is_frozen_only_while_the_left_one_moves() -> None:
    image = scene()
    still = image_change(noisy(image, 1.0), noisy(image, 1.0))
    moved = image_change(image, np.roll(image, 3, axis=1))
    assert is_right_frozen(moved, still)
    assert not is_right_frozen(still, still)
    assert not is_right_frozen(ImageChange(Repetition.NONE, 0.25), still)
    assert not is_right_frozen(moved, moved)
    brighter = image_change(image, image + np.uint8(15))
    assert brighter.repetition is Repetition.NONE and np.isnan(brighter.motion_px)
    assert not is_right_frozen(brighter, still)


def test_a_glitch_of_the_left_camera_while_the_pair_stands_is_no_frozen_right_camera() -> None:
    image = scene()
    detector = RepetitionDetector()
    for _ in range(3):
        detector.update((noisy(image, 1.0), noisy(image, 1.0)))
    detector.update((noisy(scene(), 1.0), noisy(image, 1.0)))
    assert not detector.is_right_frozen
