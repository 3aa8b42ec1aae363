"""Contrast of dark and hazy images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.faults import FaultKind
from vo.base.types import Bytes
from vo.engine.frontend.contrast import ContrastCorrection, noise_level

SHAPE = (240, 320)


def scene(
    *, contrast: float, mean: float = 100.0, blur_px: float = 0.5, noise: float = 1.0
) -> Bytes:
    """A texture with detail at several scales, with a standard deviation of 40 times `contrast`."""
    rng = np.random.default_rng(0)
    texture = sum(
        cv2.resize(rng.normal(size=(SHAPE[0] // s, SHAPE[1] // s)), SHAPE[::-1]) for s in (2, 6, 20)
    )
    smooth = cv2.GaussianBlur(np.asarray(texture), (0, 0), blur_px)
    smooth *= 40.0 / smooth.std()
    noisy = mean + contrast * smooth + rng.normal(0.0, noise, SHAPE)
    return np.asarray(np.clip(noisy.round(), 0, 255), np.uint8)


def spread(image: Bytes | None) -> float:
    assert image is not None
    low, high = np.percentile(image, (5, 95))
    return float(high - low)


def test_images_in_good_light_stay_the_same_objects() -> None:
    correction = ContrastCorrection()
    images = scene(contrast=1.0), scene(contrast=0.6)
    assert all(a is b for a, b in zip(correction.update(images), images, strict=True))
    assert correction.faults == ()


@pytest.mark.parametrize("mean", [12.0, 200.0])
def test_the_range_of_dark_and_hazy_images_is_spread(mean: float) -> None:
    image = scene(contrast=0.12, mean=mean)
    correction = ContrastCorrection()
    left, right = correction.update((image, image))
    assert left is not None
    assert 90.0 < spread(left) < 125.0
    assert np.mean(left) == pytest.approx(110.0, abs=8.0)
    np.testing.assert_array_equal(left, right)


def test_noise_is_filtered() -> None:
    image = scene(contrast=0.12, noise=1.5)
    (raised,) = ContrastCorrection().update((image,))
    assert raised is not None
    gain = spread(raised) / spread(image)
    assert noise_level(raised) < 0.5 * gain * noise_level(image)


@pytest.mark.parametrize("seen_before", [False, True])
def test_noise_alone_is_not_raised(seen_before: bool) -> None:
    correction = ContrastCorrection()
    if seen_before:
        correction.update((scene(contrast=0.1),))
    covered = scene(contrast=0.0, mean=5.0, noise=1.5)
    assert correction.update((covered,))[0] is covered


def test_the_range_follows_slowly() -> None:
    correction = ContrastCorrection()
    image = scene(contrast=0.12)
    (before,) = correction.update((image,))
    correction.update((scene(contrast=0.4),))
    (after,) = correction.update((image,))
    assert 0.5 * spread(before) < spread(after) < spread(before)


@pytest.mark.parametrize(("blur_px", "is_faint"), [(0.5, False), (4.0, True)])
def test_edges_that_drown_in_noise_are_a_fault(blur_px: float, is_faint: bool) -> None:
    correction = ContrastCorrection()
    for _ in range(48):
        correction.update((scene(contrast=0.1, blur_px=blur_px, noise=1.5),))
    assert [fault.kind for fault in correction.faults] == [FaultKind.FAINT_IMAGES] * is_faint
    assert not any(fault.is_handled for fault in correction.faults)
    for _ in range(10):
        correction.update((scene(contrast=1.0),))
    assert correction.faults == ()


def test_a_clear_right_image_stays_as_it_is_beside_a_fogged_left_one() -> None:
    correction = ContrastCorrection()
    fogged, clear = scene(contrast=0.1), scene(contrast=1.0)
    assert spread(clear) > 64.0
    left, right = correction.update((fogged, clear))
    assert left is not fogged and right is clear
    both = correction.update((fogged, scene(contrast=0.15)))
    assert both[1] is not None and spread(both[1]) > 64.0
