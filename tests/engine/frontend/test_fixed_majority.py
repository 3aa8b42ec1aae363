"""Content that covers most of the image, or the background of a train, is never trusted."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from fixed_scenes import SHAPE, find, noisy, panning, passed_by, texture, with_body

from vo.base.types import Bytes, Floats32
from vo.engine.frontend.dark_border import DarkBorder
from vo.engine.frontend.pair_matching import PairPoints, is_scene

_BASELINE_PX = 50.0


def _with_text(images: list[Floats32]) -> list[Bytes]:
    """Lines of text over 60 % of the height, on a dark ground."""
    result = []
    for number, image in enumerate(images):
        shown = image.astype(np.uint8)
        for top in range(4, SHAPE[0] - 22, 36):
            shown[top : top + 22] //= 3
            text = "CAM 1 REC 043 KM/H N 48.9843 E 8.3921"
            at, font = (2, top + 16), cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(shown, text, at, font, 0.5, 255, 1, cv2.LINE_AA)
        result.append(noisy(shown.astype(np.float32), number))
    return result


def _points(depth_m: float) -> PairPoints:
    """Points all over a pair of images, at one depth."""
    v, u = (each.ravel().astype(np.float64) for each in np.mgrid[8:232:8, 8:352:8])
    return PairPoints(np.column_stack([u, v]), np.column_stack([u - _BASELINE_PX / depth_m, v]))


@pytest.mark.parametrize("share", [0.6, 0.7, 0.8])
def test_a_body_over_most_of_the_image_is_doubted(share: float) -> None:
    found = find(with_body(panning(4.0, 45), round(SHAPE[0] * (1 - share))))
    assert all(each.mask is None for each in found)
    doubted = [each for each in found if each.is_ambiguous]
    assert doubted and 0.2 * share < doubted[0].share < 1.1 * share


def test_text_over_most_of_the_image_is_doubted() -> None:
    *_, found = find(_with_text(panning(2.0, 45)))
    assert found.mask is None and found.is_ambiguous


@pytest.mark.parametrize("light", [1.0, 0.1])
def test_a_camera_at_rest_is_not_doubted(light: float) -> None:
    scene = light * texture(5, SHAPE[1])
    assert not any(each.is_present for each in find(noisy(scene, i, 3.0) for i in range(90)))


def test_a_camera_at_rest_that_stereo_shows_is_not_doubted_beside_a_small_train() -> None:
    images = list(passed_by(texture(6, SHAPE[1]), 60, slice(150, 190), SHAPE[1]))
    assert find(images)[-1].is_ambiguous
    assert find(images, _BASELINE_PX, _points(0.5))[-1].is_ambiguous
    assert not any(each.is_present for each in find(images, _BASELINE_PX, _points(8.0)))


@pytest.mark.parametrize(("depth_m", "is_handled"), [(0.5, True), (8.0, False), (1e6, True)])
def test_what_is_far_away_is_no_body(depth_m: float, is_handled: bool) -> None:
    *_, found = find(with_body(panning(4.0), 180), _BASELINE_PX, _points(depth_m))
    (fault,) = found.faults
    assert fault.is_handled == is_handled and (found.mask is not None) == is_handled


def test_the_background_above_a_train_is_no_body() -> None:
    *_, found = find(passed_by(texture(6, SHAPE[1]), 60, slice(80, SHAPE[0]), SHAPE[1]))
    assert found.mask is None and found.is_ambiguous


def test_few_points_show_no_scene() -> None:
    fixed = np.zeros((SHAPE[0] // 2, SHAPE[1] // 2), dtype=bool)
    fixed[100:] = True
    assert is_scene(fixed, _points(8.0), _BASELINE_PX)
    assert not is_scene(fixed[:, :8], _points(8.0), _BASELINE_PX)
    assert not is_scene(fixed, None, _BASELINE_PX)


_TOP, _LEFT, _BORDER_BASELINE_PX = 40, 20, 50.0


def _letterboxed(count: int) -> list[Bytes]:
    images = []
    for number, image in enumerate(panning(4.0, count)):
        framed = np.zeros_like(image)
        inside = slice(_TOP, -_TOP), slice(_LEFT, -_LEFT)
        framed[inside] = np.maximum(image[inside], 60.0)
        images.append(noisy(framed, number))
    return images


def _far_points() -> PairPoints:
    v, u = (each.ravel().astype(np.float64) for each in np.mgrid[8:232:4, 8:352:4])
    return PairPoints(np.column_stack([u, v]), np.column_stack([u - _BORDER_BASELINE_PX / 8.0, v]))


def test_a_dark_border_is_left_out_although_far_points_lie_along_it() -> None:
    *_, found = find(_letterboxed(60), _BORDER_BASELINE_PX, _far_points())
    assert found.mask is not None and not found.is_ambiguous
    assert not found.mask[: _TOP + 8].any() and not found.mask[:, : _LEFT + 8].any()
    assert (found.mask[_TOP + 30 : -_TOP - 30, _LEFT + 30 : -_LEFT - 30] > 0).all()


def test_no_border_is_near_without_one() -> None:
    border = DarkBorder()
    assert not border.near((120, 160), 8).any()
    border.update(np.full((60, 80), 90, np.uint8))
    assert not border.near((120, 160), 8).any()


def test_lamps_in_the_dark_have_no_border() -> None:
    image = np.zeros((60, 80), np.uint8)
    image[5:15, 5:15] = image[40:55, 60:75] = image[10:20, 60:70] = 200
    border = DarkBorder()
    border.update(image)
    assert not border.near((120, 160), 8).any()


def test_noise_of_a_dark_border_does_not_hide_it() -> None:
    border, rng = DarkBorder(), np.random.default_rng(1)
    for _ in range(50):
        image = rng.normal(4.0, 3.0, (60, 80)).clip(0, 255)
        image[15:45] = 120.0
        border.update(image.astype(np.uint8))
    near = border.near((120, 160), 8)
    assert near[:37].all() and near[-37:].all() and not near[42:78].any()
