from __future__ import annotations

import cv2
import numpy as np
import pytest
from feature_scenes import shapes

from vo.base.types import Bytes, Floats, Ints
from vo.engine.frontend.fast import FastGrid

BORDER = 19


def _with_faint_left_half(image: Bytes) -> Bytes:
    result = image.astype(np.float64)
    half = image.shape[1] // 2
    result[:, :half] = 128 + 0.1 * (result[:, :half] - 128)
    return np.asarray(np.round(result), dtype=np.uint8)


def _filled_share(xy: Ints, left: int, right: int, height: int, cell: int = 30) -> float:
    """Share of square cells between two columns that hold a corner."""
    columns, rows = (right - left) // cell, (height - 2 * BORDER) // cell
    cells: Floats = np.floor((xy - (left, BORDER)) / cell)
    inside = np.all((cells >= 0) & (cells < (columns, rows)), axis=1)
    return len(np.unique(cells[inside], axis=0)) / (columns * rows)


def test_corners_are_spread_evenly_also_where_contrast_is_a_tenth() -> None:
    image = _with_faint_left_half(shapes(300, 480, density=1 / 150))
    xy, _ = FastGrid(20, 7, BORDER).detect(image, 600)
    assert _filled_share(xy, 240, 480 - BORDER, 300) > 0.95
    assert _filled_share(xy, BORDER, 240, 300) > 0.8


def test_what_a_mask_hides_has_no_corners_and_the_rest_has_as_many_more() -> None:
    image = shapes(300, 480, density=1 / 100)
    mask = np.full(image.shape, 255, np.uint8)
    mask[:, :320] = 0
    every, _ = FastGrid(20, 7, BORDER).detect(image, 300)
    shown, _ = FastGrid(20, 7, BORDER).detect(image, 300, mask)
    assert shown[:, 0].min() >= 320
    assert len(shown) > 2 * np.count_nonzero(every[:, 0] >= 320)
    nothing, _ = FastGrid(20, 7, BORDER).detect(image, 300, np.zeros_like(mask))
    assert len(nothing) == 0


def test_the_lower_threshold_is_what_finds_corners_in_faint_cells() -> None:
    image = _with_faint_left_half(shapes(300, 480, density=1 / 150))
    with_low, _ = FastGrid(20, 7, BORDER).detect(image, 600)
    without, _ = FastGrid(20, 20, BORDER).detect(image, 600)
    faint = 240 - 4
    assert np.sum(with_low[:, 0] < faint) > 100
    assert np.sum(without[:, 0] < faint) < 10


def test_the_lower_threshold_is_not_used_where_there_is_contrast() -> None:
    image = shapes(300, 480, density=1 / 150)
    low, _ = FastGrid(20, 7, BORDER).detect(image, 100)  # cells so large that none is poor
    same, _ = FastGrid(20, 20, BORDER).detect(image, 100)
    np.testing.assert_array_equal(low, same)


def test_one_rich_spot_does_not_take_all_corners() -> None:
    image = 128 + 0.4 * (shapes(300, 480, density=1 / 300).astype(np.float64) - 128)
    image[100:160, 300:380] = shapes(60, 80, density=1 / 60)
    image = np.asarray(np.round(image), dtype=np.uint8)
    detector = FastGrid(20, 7, BORDER)
    every, scores = detector.detect(image, 5000)
    xy, _ = detector.detect(image, 150)
    assert _share_in_spot(every[np.argsort(-scores)[:150]]) > 0.4
    assert _share_in_spot(xy) < 0.15
    assert _filled_share(xy, BORDER, 480 - BORDER, 300, cell=60) > 0.95


def _share_in_spot(xy: Ints) -> float:
    return float(np.mean(np.all((xy >= (300, 100)) & (xy < (380, 160)), axis=1)))


@pytest.mark.parametrize("count", [0, 1, 37, 500])
def test_never_more_corners_than_asked_for(count: int) -> None:
    xy, scores = FastGrid(20, 7, BORDER).detect(shapes(300, 480), count)
    assert len(xy) == len(scores) == count


def test_corners_keep_clear_of_the_border_and_occur_once() -> None:
    xy, scores = FastGrid(20, 7, BORDER).detect(shapes(300, 480), 5000)
    assert np.all(xy >= BORDER)
    assert np.all(xy < (480 - BORDER, 300 - BORDER))
    assert len(np.unique(xy, axis=0)) == len(xy)
    assert np.all(scores > 0)


@pytest.mark.parametrize("size", [(1, 1), (38, 200), (200, 38), (39, 39), (41, 60)])
def test_small_images_give_few_corners_or_none(size: tuple[int, int]) -> None:
    image = shapes(*size, density=1 / 50)
    xy, scores = FastGrid(20, 7, BORDER).detect(image, 100)
    assert xy.shape == (len(scores), 2)
    assert np.all((xy >= BORDER) & (xy < (size[1] - BORDER, size[0] - BORDER)))


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_a_blank_image_has_no_corners(grey: int) -> None:
    xy, scores = FastGrid(20, 7, BORDER).detect(np.full((200, 300), grey, np.uint8), 500)
    assert xy.shape == (0, 2)
    assert scores.shape == (0,)


@pytest.mark.parametrize("threshold", [1, 7, 20, 120])
@pytest.mark.parametrize("width", [480, 487])
def test_corners_and_scores_are_those_of_opencv(threshold: int, width: int) -> None:
    rng = np.random.default_rng(3)
    image = shapes(300, width, density=1 / 150)
    image = np.asarray(np.clip(image + rng.normal(0, 3, image.shape), 0, 255), dtype=np.uint8)
    image[120:140] = 0  # as bright and as dark as can be
    image[121:140:7, ::9] = 255
    reach = BORDER - 3  # so that it looks where we do, and no farther
    inner = image[reach:-reach, reach:-reach]
    keypoints = cv2.FastFeatureDetector.create(threshold, True).detect(inner)
    expected = [(k.pt[0] + reach, k.pt[1] + reach, k.response) for k in keypoints]
    xy, scores = FastGrid(threshold, 255, BORDER).detect(image, 10**6)  # none of poor cells
    assert len(expected) > 100
    np.testing.assert_array_equal(np.column_stack([xy, scores]), expected)


def test_a_border_narrower_than_the_ring_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 3"):
        FastGrid(20, 7, 2)
