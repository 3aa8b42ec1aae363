"""The vectorised alignment against the plain one, and on what only it can do."""

from __future__ import annotations

import numpy as np
import pytest
from feature_scenes import Waves, as_image, pixels

from vo.base.types import Bytes, Floats, Ints
from vo.engine.frontend.patch_alignment import Alignment, Patches, align_between, patches_of

HEIGHT, WIDTH = 160, 210
WARPS = [None, np.array([[1.1, 0.15], [-0.1, 0.9]])]


def _scenes(count: int) -> Bytes:
    """Images of as many scenes, with a little noise."""
    rng = np.random.default_rng(0)
    xy = pixels(HEIGHT, WIDTH)
    return np.stack(
        [
            as_image(Waves(seed=s).at(xy) + 4.0 * rng.standard_normal(xy.shape[:2]))
            for s in range(count)
        ]
    )


def _positions(count: int) -> Floats:
    """Pixels all over the image and just outside of it, some of them whole."""
    xy = np.random.default_rng(1).uniform((-3, -3), (WIDTH + 3, HEIGHT + 3), (count, 2))
    xy[::2] = np.round(xy[::2])
    return xy


def _plainly(
    images: Bytes, reference: Ints, xy: Floats, warp: Floats, target: int, half_px: int
) -> Alignment:
    warps = np.tile(warp, (len(xy), 1, 1))
    return align_between(
        Patches(images, reference, xy, np.linalg.inv(warps)),
        images[target][None],
        np.zeros(len(xy), np.int64),
        xy + (0.7, -0.4),
        half_px=half_px,
    )


@pytest.mark.parametrize("half_px", [2, 5, 6, 7, 10])
@pytest.mark.parametrize("warp", WARPS)
def test_it_finds_what_the_plain_alignment_finds(warp: Floats | None, half_px: int) -> None:
    images, xy = _scenes(2), _positions(600)
    reference, target = np.arange(600) % 2, np.arange(600) // 2 % 2
    every = None if warp is None else np.tile(np.linalg.inv(warp), (600, 1, 1))
    start = xy + (0.7, -0.4)
    found = align_between(
        Patches(images, reference, xy, every), images, target, start, half_px=half_px
    )
    for t in (0, 1):
        mine = target == t
        used = np.eye(2) if warp is None else warp
        plain = _plainly(images, reference[mine], xy[mine], used, t, half_px)
        assert np.array_equal(found.converged[mine], plain.converged)
        assert 0.2 < plain.converged.mean() < 0.9
        kept = plain.converged
        np.testing.assert_allclose(found.xy[mine][kept], plain.xy[kept], atol=2e-3)
        np.testing.assert_allclose(found.score[mine][kept], plain.score[kept], atol=1e-4)
        assert np.array_equal(found.score[mine] == -1.0, plain.score == -1.0)


@pytest.mark.parametrize("shape", [(9, 400), (400, 9), (16, 16), (15, 24), (23, 17)])
@pytest.mark.parametrize("half_px", [2, 6, 10])
def test_small_images_are_never_left(shape: tuple[int, int], half_px: int) -> None:
    image = as_image(Waves().at(pixels(*shape)))
    xy = np.random.default_rng(2).uniform((0, 0), (shape[1], shape[0]), (300, 2))
    beyond = np.full(shape, 255, np.uint8)
    for after in (image, beyond):  # what lies behind the image in memory makes no difference
        both = np.stack([image, after])
        slot = np.zeros(300, np.int64)
        found = align_between(Patches(both, slot, xy), both, slot, xy, half_px=half_px)
        assert not found.converged[(xy < half_px).any(axis=1)].any()
        if after is image:
            first = found
    np.testing.assert_array_equal(found.xy, first.xy)
    np.testing.assert_array_equal(found.score, first.score)


def test_a_position_that_is_no_number_is_refused() -> None:
    images = _scenes(1)
    inside, nowhere = np.array([[60.0, 60.0]]), np.array([[np.nan, 60.0]])
    slot, none = np.zeros(1, np.int64), np.full((1, 2, 2), np.nan)
    for xy, start, stretch in ((inside, nowhere, None), (nowhere, inside, None)):
        assert not align_between(
            Patches(images, slot, xy, stretch), images, slot, start, half_px=6
        ).converged.any()
    assert not align_between(
        Patches(images, slot, inside, none), images, slot, inside, half_px=6
    ).converged.any()


def test_no_patches_are_found_where_none_are_given() -> None:
    images, nothing, none = _scenes(1), np.empty((0, 2)), np.empty(0, np.int64)
    found = align_between(Patches(images, none, nothing), images, none, nothing, half_px=6)
    assert found.xy.shape == (0, 2) and found.score.shape == (0,) and found.converged.shape == (0,)


def test_patches_larger_than_supported_are_an_error() -> None:
    images, xy, slot = _scenes(1), np.array([[60.0, 60.0]]), np.zeros(1, np.int64)
    with pytest.raises(ValueError, match="half_px is 11"):
        align_between(Patches(images, slot, xy), images, slot, xy, half_px=11)


@pytest.mark.parametrize("noise", [2.0, 8.0])
def test_errors_go_with_sigma(noise: float) -> None:
    rng, at = np.random.default_rng(3), pixels(HEIGHT, WIDTH)
    scene = Waves(seed=5, shortest_px=12.0)
    images = [as_image(scene.at(at) + noise * rng.standard_normal(at.shape[:2])) for _ in (0, 1)]
    xy = rng.uniform((20, 20), (WIDTH - 20, HEIGHT - 20), (400, 2))
    only = np.zeros(len(xy), dtype=np.int64)
    found = align_between(patches_of(images[0], xy), images[1][None], only, xy + 0.3, half_px=6)
    error = (found.xy - xy)[found.converged]
    assert len(error) > 350
    sigma = found.sigma_px[found.converged]
    order = np.argsort(sigma)
    for part in (order[:100], order[-100:]):  # interpolation adds about as much again
        assert 1.0 < np.sqrt(np.mean(error[part] ** 2) / np.mean(sigma[part] ** 2)) < 2.5
    assert np.mean(error[order[-100:]] ** 2) > 1.3 * np.mean(error[order[:100]] ** 2)


def test_too_few_steps_are_near_enough_only_where_the_last_was_short() -> None:
    images, xy = _scenes(2)[:1], _positions(300)
    only = np.zeros(len(xy), dtype=np.int64)
    few, many = (
        align_between(
            Patches(images, only, xy),
            images,
            only,
            xy + (0.7, -0.4),
            half_px=6,
            iterations=iterations,
        )
        for iterations in (3, 12)
    )
    assert (few.nearly | ~few.converged).all()
    assert few.converged.mean() < few.nearly.mean() < many.nearly.mean() + 1e-9
    off = np.linalg.norm(few.xy - xy, axis=1)
    assert off[few.nearly].max() < 0.05
