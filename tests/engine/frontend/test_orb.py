from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from feature_scenes import shapes
from matched_rows import match_everywhere

from vo.base.config import FeaturesConfig
from vo.base.types import Bytes, Floats, Keypoints
from vo.engine.frontend.orb import OrbExtractor

CONFIG = FeaturesConfig(count=800)


def _detect(image: Bytes) -> Keypoints:
    return OrbExtractor(CONFIG).extract(image)


def _nearest(points: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Offsets (N, 2) to the nearest of the others, and their lengths."""
    offsets = others[None] - points[:, None]
    length = np.linalg.norm(offsets, axis=2)
    row = np.argmin(length, axis=1)
    every = np.arange(len(points))
    return offsets[every, row], length[every, row]


def test_rows_of_the_arrays_belong_together() -> None:
    found = _detect(shapes(300, 480))
    n = len(found)
    assert 400 < n <= CONFIG.count * 1.01
    assert found.xy.shape == (n, 2) and found.xy.dtype == np.float32
    assert found.octave.shape == (n,) and found.octave.dtype == np.int32
    assert found.angle.shape == (n,) and found.angle.dtype == np.float32
    assert found.response.shape == (n,) and found.response.dtype == np.float32
    assert found.descriptor.shape == (n, 32) and found.descriptor.dtype == np.uint8
    assert set(found.octave) <= set(range(CONFIG.levels))
    assert np.all(found.xy >= 0) and np.all(found.xy < (480, 300))
    assert np.all(np.abs(found.angle) <= np.pi + 1e-6)


def test_the_same_image_gives_the_same_features() -> None:
    image = shapes(300, 480)
    first, again = _detect(image), _detect(image.copy())
    for name in ("xy", "octave", "angle", "response", "descriptor"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_a_helper_for_the_smaller_levels_changes_no_feature() -> None:
    image = shapes(300, 480)
    alone = _detect(image)
    with ThreadPoolExecutor(1) as helper:
        shared = OrbExtractor(CONFIG).extract(image, helper=helper)
    for name in ("xy", "octave", "angle", "response", "descriptor"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(shared, name))


def test_descriptors_are_those_of_opencv() -> None:
    found = _detect(shapes(300, 480))
    first = found.octave == 0
    keypoints = [
        cv2.KeyPoint(float(x), float(y), 31.0, float(angle))
        for (x, y), angle in zip(found.xy[first], np.rad2deg(found.angle[first]), strict=True)
    ]
    opencv = cv2.ORB.create(nlevels=1, edgeThreshold=16, patchSize=31)
    kept, expected = opencv.compute(shapes(300, 480), keypoints)
    assert len(kept) == len(keypoints) > 200
    bits = np.unpackbits(expected ^ found.descriptor[first])
    assert bits.mean() < 1e-5  # a pixel's place may be rounded the other way


def test_a_scene_turned_by_30_degrees_is_recognised() -> None:
    image = shapes(400, 400)
    turn = cv2.getRotationMatrix2D((199.5, 199.5), -30.0, 1.0)  # clockwise, as image angles grow
    turned = cv2.warpAffine(image, turn, (400, 400), flags=cv2.INTER_CUBIC, borderValue=128)
    a, b = _detect(image), _detect(turned)
    matched = match_everywhere(a.descriptor, b.descriptor, max_distance=64, ratio=0.85)
    rows = np.flatnonzero(matched >= 0)
    expected = a.xy[rows] @ turn[:, :2].T + turn[:, 2]
    size = 1.2 ** a.octave[rows]
    right = np.linalg.norm(b.xy[matched[rows]] - expected, axis=1) < 2.5 * size
    assert right.sum() > 150
    assert right.mean() > 0.85
    change = b.angle[matched[rows]] - a.angle[rows]
    off = np.angle(np.exp(1j * (change[right] - np.deg2rad(30.0))))
    assert abs(np.rad2deg(np.median(off))) < 2.0
    assert np.rad2deg(np.median(np.abs(off))) < 6.0


@pytest.mark.parametrize("size", [(300, 480), (331, 507)])
def test_pixel_centres_lie_at_whole_numbers_on_every_octave(size: tuple[int, int]) -> None:
    height, width = size
    image = shapes(height, width)
    detector = OrbExtractor(FeaturesConfig(count=5000))  # all corners, so that none lacks its twin
    found = detector.extract(image)
    mirrored = detector.extract(np.ascontiguousarray(image[::-1, ::-1]))
    for octave in range(CONFIG.levels):
        here = found.xy[found.octave == octave].astype(np.float64)
        there = mirrored.xy[mirrored.octave == octave].astype(np.float64)
        scale = CONFIG.scale_factor**octave
        offset, length = _nearest(here, (width - 1, height - 1) - there)
        same = length < 2.0 * scale
        assert same.mean() > 0.5
        # With half a pixel of the octave left out, this would be (scale - 1) / 2 twice.
        assert np.all(np.abs(np.mean(offset[same], axis=0)) < 0.05 * scale), octave


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_features_of_a_resized_image_lie_where_resizing_puts_them(factor: float) -> None:
    image = shapes(320, 480)
    size = (round(480 * factor), round(320 * factor))
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    resized = np.asarray(cv2.resize(image, size, interpolation=way), dtype=np.uint8)
    a, b = _detect(image), _detect(resized)
    matched = match_everywhere(a.descriptor, b.descriptor, max_distance=64, ratio=0.85)
    rows = np.flatnonzero(matched >= 0)
    offset = b.xy[matched[rows]] - ((a.xy[rows] + 0.5) * factor - 0.5)
    near = np.linalg.norm(offset, axis=1) < 4.0 * factor
    assert near.sum() > 100 and near.mean() > 0.7
    assert np.all(np.abs(np.mean(offset[near], axis=0)) < 0.25 * max(factor, 1.0))
    assert np.median(np.linalg.norm(offset[near], axis=1)) < 1.0 * max(factor, 1.0)


def test_noise_free_copies_match_at_distance_zero() -> None:
    found = _detect(shapes(300, 480))
    shifted = _detect(np.asarray(np.roll(shapes(300, 480), (5, 7), (0, 1))))
    first = found.octave == 0
    there = shifted.xy[shifted.octave == 0] - (7, 5)
    offset, length = _nearest(found.xy[first].astype(np.float64), there.astype(np.float64))
    same = length == 0.0
    assert same.mean() > 0.7
    assert len(offset) == first.sum()


@pytest.mark.parametrize("size", [(8, 8), (38, 300), (45, 45)])
def test_images_too_small_for_a_patch_give_no_or_few_features(size: tuple[int, int]) -> None:
    found = _detect(shapes(*size, density=1 / 40))
    assert found.descriptor.shape == (len(found), 32)
    assert np.all(found.octave == 0)


def test_a_blank_image_has_no_features() -> None:
    found = _detect(np.full((200, 300), 90, np.uint8))
    assert len(found) == 0
    assert found.descriptor.shape == (0, 32)


def test_views_of_a_larger_array_are_read_right() -> None:
    image = shapes(300, 480)
    padded = np.zeros((320, 500), np.uint8)
    padded[10:310, 5:485] = image
    view = padded[10:310, 5:485]
    np.testing.assert_array_equal(_detect(view).descriptor, _detect(image).descriptor)
