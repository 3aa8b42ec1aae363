"""Optical flow on moved images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.types import Bytes, Floats
from vo.engine.frontend.image_gradients import mean_product
from vo.engine.frontend.optical_flow import follow


def texture() -> Bytes:
    noise = np.random.default_rng(0).integers(0, 256, (240, 320)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def grid() -> Floats:
    u, v = np.meshgrid(np.arange(40.0, 290.0, 10.0), np.arange(40.0, 210.0, 10.0))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def moved(image: Bytes, affine: Floats) -> Bytes:
    size = image.shape[1], image.shape[0]
    border = cv2.BORDER_REFLECT_101
    return cv2.warpAffine(image, affine, size, flags=cv2.INTER_CUBIC, borderMode=border)


def test_points_are_found_to_a_fraction_of_a_pixel() -> None:
    image, xy = texture(), grid()
    affine = np.array([[1.02, 0.01, 6.3], [-0.01, 1.01, -4.6]])
    flow = follow(image, moved(image, affine), xy, xy)
    expected = xy @ affine[:, :2].T + affine[:, 2]
    inside = ((expected > 45) & (expected < [275, 195])).all(axis=1)
    assert flow.found[inside].mean() > 0.97
    errors = np.linalg.norm(flow.xy - expected, axis=1)[inside & flow.found]
    assert np.median(errors) < 0.08
    assert errors.max() < 0.3


def test_what_is_hidden_or_has_left_is_not_found() -> None:
    image, xy = texture(), grid()
    covered = image.copy()
    other = texture()[::-1].copy()
    covered[:, 160:] = other[:, 160:]
    flow = follow(image, covered, xy, xy)
    left, right = xy[:, 0] < 140, xy[:, 0] > 180
    assert flow.found[left].all()
    assert flow.found[right].mean() < 0.2
    flat = np.full_like(image, 90)
    assert not follow(image, flat, xy, xy).found.any()
    assert not follow(image, image, xy, xy + 1000.0).found.any()
    assert len(follow(image, image, xy[:0], xy[:0]).found) == 0


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
