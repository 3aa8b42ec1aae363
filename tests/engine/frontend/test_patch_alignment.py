from __future__ import annotations

import numpy as np
import pytest
from feature_scenes import Waves, as_image, pixels

from vo.base.types import Bytes, Floats
from vo.engine.frontend.patch_alignment import Alignment, Patches, align_between, patches_of

HEIGHT, WIDTH = 220, 260
SHIFTS = [(0.0, 0.0), (0.25, -0.4), (0.5, 0.5), (-0.73, 0.11), (1.3, -1.2)]


def _grid() -> Floats:
    """Pixels at which patches are cut: half of them between whole pixels."""
    u, v = np.meshgrid(np.arange(40.0, WIDTH - 40, 12), np.arange(40.0, HEIGHT - 40, 12))
    xy = np.column_stack([u.ravel(), v.ravel()])
    xy[::2] += (0.37, 0.61)
    return xy


def _views(
    shift: tuple[float, float],
    *,
    warp: Floats | None = None,
    gain: float = 1.0,
    offset: float = 0.0,
    noise: float = 0.0,
) -> tuple[Bytes, Bytes, Floats]:
    """A reference, a target, and where the grid's patches lie in the target."""
    scene, xy = Waves(), pixels(HEIGHT, WIDTH)
    stretch = np.eye(2) if warp is None else warp
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    back = np.linalg.inv(stretch)
    rng = np.random.default_rng(0)
    reference = scene.at(xy) + noise * rng.standard_normal(xy.shape[:2])
    target = scene.at((xy - middle - shift) @ back.T + middle)
    target = gain * target + offset + noise * rng.standard_normal(xy.shape[:2])
    truth = (_grid() - middle) @ stretch.T + middle + shift
    return as_image(reference), as_image(target), truth


def _align(
    reference: Bytes, target: Bytes, xy: Floats, start: Floats, warp: Floats | None = None
) -> Alignment:
    stretch = np.eye(2) if warp is None else warp
    return align_between(
        patches_of(reference, xy, np.tile(np.linalg.inv(stretch), (len(xy), 1, 1))),
        target[None],
        np.zeros(len(xy), np.int64),
        start,
        half_px=6,
    )


def _errors(found: Alignment, truth: Floats) -> Floats:
    return np.linalg.norm(found.xy - truth, axis=1)[found.converged]


@pytest.mark.parametrize("shift", SHIFTS)
def test_shifts_are_found_to_a_few_hundredths_of_a_pixel(shift: tuple[float, float]) -> None:
    reference, target, truth = _views(shift)
    found = _align(reference, target, _grid(), _grid())
    assert found.converged.mean() > 0.95
    assert np.median(_errors(found, truth)) < 0.03
    assert np.median(found.score[found.converged]) > 0.99


@pytest.mark.parametrize("shift", SHIFTS)
def test_noise_of_5_grey_levels_costs_less_than_a_tenth_of_a_pixel(
    shift: tuple[float, float],
) -> None:
    reference, target, truth = _views(shift, noise=5.0)
    found = _align(reference, target, _grid(), _grid())
    assert found.converged.mean() > 0.95
    assert np.median(_errors(found, truth)) < 0.1


def test_the_shift_is_found_without_bias() -> None:
    reference, target, truth = _views((0.4, -0.3), noise=5.0)
    found = _align(reference, target, _grid(), _grid())
    close = found.converged & (np.linalg.norm(found.xy - truth, axis=1) < 1.0)
    assert np.all(np.abs(np.mean((found.xy - truth)[close], axis=0)) < 0.02)


@pytest.mark.parametrize(
    "warp", [1.2 * np.eye(2), np.eye(2) / 1.2, np.array([[1.1, 0.15], [-0.1, 0.95]])]
)
def test_stretched_patches_are_found(warp: Floats) -> None:
    reference, target, truth = _views((0.3, -0.2), warp=warp)
    inside = np.all((truth > 12) & (truth < (WIDTH - 12, HEIGHT - 12)), axis=1)
    found = _align(reference, target, _grid()[inside], truth[inside] + (0.6, -0.5), warp)
    assert found.converged.mean() > 0.95
    assert np.median(_errors(found, truth[inside])) < 0.03


@pytest.mark.parametrize(("gain", "offset"), [(0.6, 20.0), (1.3, -30.0), (1.0, 40.0)])
def test_a_change_of_exposure_does_not_move_patches(gain: float, offset: float) -> None:
    reference, target, truth = _views((0.25, -0.4), gain=gain, offset=offset)
    found = _align(reference, target, _grid(), _grid())
    assert found.converged.mean() > 0.95
    assert np.median(_errors(found, truth)) < 0.03
    assert np.median(found.score[found.converged]) > 0.98


def test_another_scene_scores_low() -> None:
    reference, _, _ = _views((0.0, 0.0))
    target = as_image(Waves(seed=7).at(pixels(HEIGHT, WIDTH)))
    found = _align(reference, target, _grid(), _grid())
    assert np.mean(found.converged & (found.score > 0.8)) < 0.05


def test_every_patch_is_cut_from_its_own_reference() -> None:
    xy = pixels(HEIGHT, WIDTH)
    scenes = [as_image(Waves(seed=s).at(xy)) for s in (1, 2, 3)]
    number = np.arange(len(_grid())) % 3
    found = align_between(
        Patches(np.stack(scenes), number, _grid()),
        scenes[1][None],
        np.zeros(len(number), np.int64),
        _grid(),
        half_px=6,
    )
    right = number == 1
    np.testing.assert_allclose(found.xy[right], _grid()[right], atol=0.02)
    assert found.score[right].min() > 0.99
    assert np.mean(found.score[~right] > 0.9) < 0.02


@pytest.mark.parametrize("turn_deg", [0, 30, 90, 135])
def test_patches_on_a_straight_edge_are_refused(turn_deg: float) -> None:
    normal = np.array([np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))])
    away = (pixels(100, 100) - 50.0) @ normal
    image = as_image(128 + 90 * np.tanh(away / 1.5))
    at = np.array([[50.0, 50.0]])
    assert not _align(image, image, at, at).converged.any()


def test_blank_patches_are_refused() -> None:
    image = np.full((100, 100), 77, np.uint8)
    at = np.array([[50.0, 50.0]])
    found = _align(image, image, at, at)
    assert not found.converged.any()
    assert found.score.tolist() == [-1.0]


@pytest.mark.parametrize(
    "bad", [(-5.0, 50.0), (3.0, 50.0), (50.0, HEIGHT - 2.0), (WIDTH + 9.0, 50.0), (1e9, 50.0)]
)
def test_patches_outside_of_either_image_are_refused(bad: tuple[float, float]) -> None:
    reference, target, _ = _views((0.0, 0.0))
    inside, outside = np.array([[60.0, 60.0]]), np.array([bad])
    for found in (
        _align(reference, target, outside, inside),
        _align(reference, target, inside, outside),
    ):
        assert not found.converged.any()
        assert found.score.tolist() == [-1.0]


def test_a_position_that_is_no_number_is_refused() -> None:
    reference, target, _ = _views((0.0, 0.0))
    inside, nowhere = np.array([[60.0, 60.0]]), np.array([[np.nan, 60.0]])
    assert not _align(reference, target, inside, nowhere).converged.any()
    assert not _align(reference, target, nowhere, inside).converged.any()


def test_no_patches_are_found_where_none_are_given() -> None:
    reference, target, _ = _views((0.0, 0.0))
    found = _align(reference, target, np.empty((0, 2)), np.empty((0, 2)))
    assert found.xy.shape == (0, 2) and found.score.shape == (0,) and found.converged.shape == (0,)


def test_patches_larger_than_supported_are_an_error() -> None:
    reference, target, _ = _views((0.0, 0.0))
    at = np.array([[60.0, 60.0]])
    with pytest.raises(ValueError, match="half_px is 11"):
        align_between(
            patches_of(reference, at), target[None], np.zeros(1, np.int64), at, half_px=11
        )


def test_stretched_patches_reach_to_the_last_pixel() -> None:
    scene, xy, shift = Waves(), pixels(HEIGHT, WIDTH), np.array([-30.0, -20.0])
    reference, target = as_image(scene.at(xy)), as_image(scene.at(xy - shift))
    stretch = np.array([[1.2, 0.1], [-0.05, 0.9]])
    back = np.linalg.inv(stretch)
    # So that of the patch, with a pixel around it, nothing is left to the right and below.
    reach = 7.0 * np.abs(back).sum(axis=1)
    centre = np.array([[WIDTH - 1.01, HEIGHT - 1.01]]) - reach
    stretched = as_image(scene.at((xy - centre[0] - shift) @ back.T + centre[0]))
    found = _align(reference, stretched, centre, centre + shift + 0.4, stretch)
    assert found.converged.all()
    assert _errors(found, centre + shift).max() < 0.03
    beyond = centre + 0.02
    assert not _align(reference, target, beyond, beyond + shift, stretch).converged.any()


@pytest.mark.parametrize("change", [(0.01, 0.0), (-0.006, 0.008)])
def test_homographies_leave_no_shift_where_the_magnification_changes(
    change: tuple[float, float],
) -> None:
    place, middle = np.array([100.0, 100.0]), np.array([40.0, 40.0])
    xy, affine = pixels(81, 81) - middle, np.array([[1.1, 0.1], [-0.05, 0.9]])
    back = xy @ affine.T / np.maximum(1.0 + xy @ np.array(change), 0.1)[..., None]
    errors = []
    for seed in range(40):
        scene = Waves(seed)
        images = [as_image(scene.at(each + place)) for each in (xy, back)]
        for warp in (affine, np.concatenate([affine, [change]])):
            patch = patches_of(images[0], middle[None], warp[None])
            found = align_between(patch, images[1][None], np.zeros(1, int), middle[None], half_px=6)
            errors.append(found.xy[0] - middle)
    by_affine, by_homography = np.array(errors).reshape(-1, 2, 2).mean(axis=0)
    assert np.linalg.norm(by_affine) > 0.05
    assert np.linalg.norm(by_homography) < 0.01
