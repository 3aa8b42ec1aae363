"""What stands still in the image while the scene moves is found, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest
from fixed_scenes import SHAPE, find, noisy, panning, passed_by, texture, with_body

from vo.base.faults import FaultKind
from vo.base.types import Bytes
from vo.engine.frontend.image_fixed import place_of

_TRAIN = slice(48, 192)


@pytest.mark.parametrize("share", [0.2, 0.25, 0.3])
def test_finds_the_lower_part_that_does_not_move(share: float) -> None:
    top = round(SHAPE[0] * (1 - share))
    *_, found = find(with_body(panning(4.0), top))
    assert found.mask is not None and not found.is_ambiguous
    assert (found.mask[top + 20 : -24, 24:-24] == 0).mean() > 0.7  # some of it is flat
    assert (found.mask[: top - 30] == 0).mean() < 0.02
    assert 0.2 * share < found.share < 1.1 * share
    (fault,) = found.faults
    assert fault.kind is FaultKind.IMAGE_FIXED_FEATURES and fault.is_handled


def test_finds_it_after_the_scene_has_moved_six_times() -> None:
    found = find(with_body(panning(4.0), 180))
    first = next(i for i, each in enumerate(found) if each.mask is not None)
    assert first <= 20
    assert [each.finds for each in found[first:]] == [1] * (len(found) - first)


def test_cannot_tell_a_body_from_the_background_if_it_covers_most_of_the_image() -> None:
    *_, found = find(with_body(panning(4.0, 60), 100))
    assert found.mask is None and found.is_ambiguous
    assert not found.faults[0].is_handled


def test_forgets_content_that_moves_after_all() -> None:
    still = with_body(panning(4.0), 180)
    moving = [noisy(image, i) for i, image in enumerate(panning(5.0))]
    found = find([*still, *moving])
    assert found[len(still) - 1].mask is not None
    assert found[-1].mask is None and not found[-1].faults


def _expanding(count: int) -> Iterable[Bytes]:
    """Straight ahead: the focus of expansion is fixed, and moves far less than the rest."""
    scene = texture(3, SHAPE[1] * 2)
    for i in range(count):
        zoom = 1.0 + 0.02 * i
        by = np.array([[zoom, 0, 180 - 360 * zoom], [0, zoom, 120 - 120 * zoom]], np.float32)
        yield noisy(cv2.warpAffine(scene, by, SHAPE[::-1]), i)


def _past_a_plane(count: int) -> Iterable[Bytes]:
    """Sideways over the ground: rows move from nothing at the horizon to 8 px at the bottom."""
    scene = texture(4)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    for i in range(count):
        moved = u + i * 8.0 * v / SHAPE[0]
        yield noisy(cv2.remap(scene, moved, v, cv2.INTER_LINEAR), i)


def _with_a_slow_part(count: int) -> Iterable[Bytes]:
    """As a distant place drifts: a fifth of a pixel per frame, where the rest moves by 4."""
    slow = panning(0.2, count)
    for i, image in enumerate(panning(4.0, count)):
        yield noisy(np.vstack([image[:180], slow[i][180:]]), i)


def _at_rest(count: int) -> Iterable[Bytes]:
    scene = texture(5, SHAPE[1])
    return (noisy(scene, i) for i in range(count))


@pytest.mark.parametrize("scene", [_expanding, _past_a_plane, _with_a_slow_part, _at_rest])
def test_finds_nothing_in_scenes(scene: Callable[[int], Iterable[Bytes]]) -> None:
    assert not any(each.is_present for each in find(scene(80)))


def test_does_not_take_the_background_of_a_train_for_a_body() -> None:
    moving = panning(4.0)
    found = find(
        [*(noisy(im, i) for i, im in enumerate(moving)), *passed_by(moving[-1], 80, _TRAIN)]
    )
    assert not any(each.is_present for each in found)


def test_cannot_tell_the_background_of_a_train_from_a_body_if_it_has_never_moved() -> None:
    found = find(passed_by(texture(6, SHAPE[1]), 90, _TRAIN))
    assert all(each.mask is None for each in found) and found[-1].is_ambiguous


def test_expects_nothing_after_enough_movements_without_afind() -> None:
    *_, found = find(noisy(image, i) for i, image in enumerate(panning(4.0)))
    assert found.is_settled and not found.is_present


def test_reports_a_reflection_over_all_of_the_image() -> None:
    reflected = texture(8, SHAPE[1])
    images = (noisy(0.7 * im + 0.3 * reflected, i) for i, im in enumerate(panning(4.0, 60)))
    *_, found = find(images)
    assert found.is_ambiguous and not found.faults[0].is_handled


@pytest.mark.parametrize(
    ("rows", "columns", "words"),
    [
        (slice(100, 120), slice(None), "bottom"),
        (slice(0, 20), slice(None), "top"),
        (slice(None), slice(0, 25), "left"),
        (slice(0, 15), slice(130, 160), "top right"),
        (slice(50, 70), slice(60, 100), ""),
        (slice(None), slice(None), ""),
    ],
)
def test_the_place_of_fixed_content_has_a_name(rows: slice, columns: slice, words: str) -> None:
    fixed = np.zeros((120, 160), dtype=bool)
    fixed[rows, columns] = True
    assert place_of(fixed) == words
