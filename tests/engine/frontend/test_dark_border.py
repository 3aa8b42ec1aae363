"""A dark border that does not move is left out, whatever lies along it; dark scenes are none."""

from __future__ import annotations

import numpy as np
from fixed_scenes import find, noisy, panning

from vo.base.types import Bytes
from vo.engine.frontend.dark_border import DarkBorder
from vo.engine.frontend.pair_matching import PairPoints

_TOP, _LEFT, _BASELINE_PX = 40, 20, 50.0


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
    return PairPoints(np.column_stack([u, v]), np.column_stack([u - _BASELINE_PX / 8.0, v]))


def test_a_dark_border_is_left_out_although_far_points_lie_along_it() -> None:
    *_, found = find(_letterboxed(60), _BASELINE_PX, _far_points())
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
