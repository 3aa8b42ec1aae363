"""What stands still in the image while the scene moves is found, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest

from vo.faults import FaultKind
from vo.frontend.camera_alignment import half_size_pyramid
from vo.frontend.image_fixed import ImageFixed, ImageFixedDetector
from vo.types import Bytes, Floats32

_SHAPE = 240, 360
_WIDE = 1400  # of the scene that images are cut from


def _texture(seed: int, width: int = _WIDE) -> Floats32:
    rng = np.random.default_rng(seed)
    texture = np.full((_SHAPE[0], width), 110.0, np.float32)
    for scale, contrast in ((2, 15), (6, 30), (24, 30)):
        noise = rng.normal(0, contrast, (_SHAPE[0] // scale + 2, width // scale + 2))
        texture += cv2.resize(noise.astype(np.float32), (width, _SHAPE[0]))
    flat = cv2.resize(rng.uniform(-1, 1, (8, width // 30)).astype(np.float32), (width, _SHAPE[0]))
    return np.clip(110 + (texture - 110) * (flat > 0), 0, 255)


def _find(images: Iterable[Bytes]) -> list[ImageFixed]:
    detector = ImageFixedDetector()
    return [detector.update(half_size_pyramid(image), image.shape) for image in images]


def _noisy(image: Floats32, number: int) -> Bytes:
    noise = np.random.default_rng(number).normal(0, 2, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def _panning(speed_px: float, count: int = 40) -> list[Floats32]:
    """A camera that turns past a scene."""
    scene = _texture(1)
    shift = [np.array([[1, 0, -speed_px * i], [0, 1, 0]], np.float32) for i in range(count)]
    return [cv2.warpAffine(scene, by, _SHAPE[::-1]) for by in shift]


def _with_body(images: list[Floats32], top: int) -> list[Bytes]:
    body = _texture(2, _SHAPE[1])
    return [_noisy(np.vstack([im[:top], body[top:]]), i) for i, im in enumerate(images)]


@pytest.mark.parametrize("share", [0.2, 0.25, 0.3])
def test_finds_the_lower_part_that_does_not_move(share: float) -> None:
    top = round(_SHAPE[0] * (1 - share))
    *_, found = _find(_with_body(_panning(4.0), top))
    assert found.mask is not None and not found.is_ambiguous
    assert (found.mask[top + 20 : -24, 24:-24] == 0).mean() > 0.7  # some of it is flat
    assert (found.mask[: top - 30] == 0).mean() < 0.02
    assert 0.2 * share < found.share < 1.1 * share
    (fault,) = found.faults
    assert fault.kind is FaultKind.IMAGE_FIXED_FEATURES and fault.is_handled


def test_finds_it_after_the_scene_has_moved_six_times() -> None:
    found = _find(_with_body(_panning(4.0), 180))
    first = next(i for i, each in enumerate(found) if each.mask is not None)
    assert first <= 20
    assert [each.finds for each in found[first:]] == [1] * (len(found) - first)


def test_cannot_tell_a_body_from_the_background_if_it_covers_most_of_the_image() -> None:
    *_, found = _find(_with_body(_panning(4.0, 60), 100))
    assert found.mask is None and found.is_ambiguous
    assert not found.faults[0].is_handled


def test_forgets_content_that_moves_after_all() -> None:
    still = _with_body(_panning(4.0), 180)
    moving = [_noisy(image, i) for i, image in enumerate(_panning(5.0))]
    found = _find([*still, *moving])
    assert found[len(still) - 1].mask is not None
    assert found[-1].mask is None and not found[-1].faults


def _expanding(count: int) -> Iterable[Bytes]:
    """Straight ahead: the focus of expansion is fixed, and moves far less than the rest."""
    scene = _texture(3, _SHAPE[1] * 2)
    for i in range(count):
        zoom = 1.0 + 0.02 * i
        by = np.array([[zoom, 0, 180 - 360 * zoom], [0, zoom, 120 - 120 * zoom]], np.float32)
        yield _noisy(cv2.warpAffine(scene, by, _SHAPE[::-1]), i)


def _past_a_plane(count: int) -> Iterable[Bytes]:
    """Sideways over the ground: rows move from nothing at the horizon to 8 px at the bottom."""
    scene = _texture(4)
    v, u = np.mgrid[: _SHAPE[0], : _SHAPE[1]].astype(np.float32)
    for i in range(count):
        moved = u + i * 8.0 * v / _SHAPE[0]
        yield _noisy(cv2.remap(scene, moved, v, cv2.INTER_LINEAR), i)


def _with_a_slow_part(count: int) -> Iterable[Bytes]:
    """As a distant place drifts: a fifth of a pixel per frame, where the rest moves by 4."""
    slow = _panning(0.2, count)
    for i, image in enumerate(_panning(4.0, count)):
        yield _noisy(np.vstack([image[:180], slow[i][180:]]), i)


def _at_rest(count: int) -> Iterable[Bytes]:
    scene = _texture(5, _SHAPE[1])
    return (_noisy(scene, i) for i in range(count))


def _passed_by(scene: Floats32, count: int) -> Iterable[Bytes]:
    """A train enters and covers 60 % of the image of a camera at rest."""
    train = _texture(7, 2000)
    for i in range(count):
        image, front = scene.copy(), min(6 * i, _SHAPE[1])
        image[48:192, :front] = train[48:192, 1000 - 6 * i : 1000 - 6 * i + front]
        yield _noisy(image, i)


@pytest.mark.parametrize("scene", [_expanding, _past_a_plane, _with_a_slow_part, _at_rest])
def test_finds_nothing_in_scenes(scene: Callable[[int], Iterable[Bytes]]) -> None:
    assert not any(each.is_present for each in _find(scene(80)))


def test_does_not_take_the_background_of_a_train_for_a_body() -> None:
    moving = _panning(4.0)
    found = _find([*(_noisy(im, i) for i, im in enumerate(moving)), *_passed_by(moving[-1], 80)])
    assert not any(each.is_present for each in found)


def test_cannot_tell_the_background_of_a_train_from_a_body_if_it_has_never_moved() -> None:
    found = _find(_passed_by(_texture(6, _SHAPE[1]), 90))
    assert all(each.mask is None for each in found) and found[-1].is_ambiguous


def test_expects_nothing_after_enough_movements_without_a_find() -> None:
    *_, found = _find(_noisy(image, i) for i, image in enumerate(_panning(4.0)))
    assert found.is_settled and not found.is_present


def test_reports_a_reflection_over_all_of_the_image() -> None:
    reflected = _texture(8, _SHAPE[1])
    images = (_noisy(0.7 * im + 0.3 * reflected, i) for i, im in enumerate(_panning(4.0, 60)))
    *_, found = _find(images)
    assert found.is_ambiguous and not found.faults[0].is_handled
