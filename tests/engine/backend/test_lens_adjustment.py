"""Adjustment of keyframes together with the lens: exact without noise, bounded with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.base.config import SmoothingConfig
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Floats
from vo.engine.backend.lens_adjustment import (
    FROM_A_GUESS,
    IDEAL,
    WITH_CENTRE,
    KeyframeViews,
    Lens,
    adjust_lens,
)
from vo.engine.geometry import so3

MIDDLE = np.array([319.5, 199.5])
CONFIG = SmoothingConfig()


def lens_of(focal: float, k1: float = 0.0, k2: float = 0.0) -> Lens:
    cx, cy = MIDDLE.tolist()
    return Lens(focal, cx, cy, k1, k2)


def views_of(lens: Lens, noise_px: float = 0.0, keyframes: int = 12) -> KeyframeViews:
    """A camera that moves sideways and forward, and turns, in front of 300 points."""
    rng = np.random.default_rng(5)
    points = np.column_stack(
        [rng.uniform(-6.0, 6.0, 300), rng.uniform(-3.0, 3.0, 300), rng.uniform(3.0, 12.0, 300)]
    )
    poses = np.stack(
        [
            make_transform(
                so3.exp(np.array([0.03 * np.sin(0.7 * k), 0.05 * np.cos(0.9 * k), 0.02 * k])),
                np.array([0.15 * k, 0.1 * np.sin(0.8 * k), 0.08 * k]),
            )
            for k in range(keyframes)
        ]
    )
    keyframe, point, xy = [], [], []
    for k, pose in enumerate(inverse(poses)):
        pixels = pixels_of(points @ pose[:3, :3].T + pose[:3, 3], lens)
        seen = ((pixels > 0.0) & (pixels < 2.0 * MIDDLE)).all(axis=1)
        keyframe += [k] * int(seen.sum())
        point += np.flatnonzero(seen).tolist()
        xy += pixels[seen].tolist()
    measured = np.array(xy) + noise_px * rng.standard_normal((len(xy), 2))
    return KeyframeViews(MIDDLE, poses, points, np.array(keyframe), np.array(point), measured)


def pixels_of(xyz: Floats, lens: Lens) -> Floats:
    ideal = xyz[:, :2] / xyz[:, 2:]
    square = (ideal**2).sum(axis=1, keepdims=True)
    return np.asarray(
        (lens.cx, lens.cy) + lens.focal * ideal * (1.0 + lens.k1 * square + lens.k2 * square**2)
    )


@pytest.mark.parametrize("lens", [lens_of(400.0), lens_of(300.0, -0.25, 0.075)])
def test_the_lens_is_exact_without_noise(lens: Lens) -> None:
    views = views_of(lens)
    guess = lens_of(1.05 * lens.focal, 0.9 * lens.k1, 0.81 * lens.k2)
    adjusted = adjust_lens(views, guess, CONFIG, FROM_A_GUESS)
    assert adjusted.lens.focal == pytest.approx(lens.focal, rel=2e-4)
    assert adjusted.lens.k1 == pytest.approx(lens.k1, abs=1e-3)
    assert adjusted.residual_px < 0.01


def test_the_error_of_the_lens_is_bounded_with_noise() -> None:
    lens = Lens(400.0, 325.0, 196.0, -0.2, 0.048)
    adjusted = adjust_lens(views_of(lens, 0.2, keyframes=30), lens_of(440.0), CONFIG, WITH_CENTRE)
    assert adjusted.lens[1:3] == pytest.approx(lens[1:3], abs=2.0)
    assert adjusted.lens.focal == pytest.approx(lens.focal, rel=5e-3)
    assert adjusted.lens.k1 == pytest.approx(lens.k1, abs=0.01)
    assert 0.1 < adjusted.residual_px < 0.3


def test_a_part_has_the_points_that_two_of_its_keyframes_observe() -> None:
    views = views_of(lens_of(400.0))
    part = views.part(3, 7)
    assert part.world_from_cam.shape == (4, 4, 4)
    assert (np.bincount(part.point) > 1).all()
    assert set(part.keyframe.tolist()) == {0, 1, 2, 3}
    assert len(part.points) == part.point.max() + 1


def test_a_camera_that_does_not_move_shows_no_lens() -> None:
    views = views_of(lens_of(400.0))
    still = replace(views, world_from_cam=np.repeat(views.world_from_cam[:1], 12, axis=0))
    with pytest.raises(np.linalg.LinAlgError, match="did not move"):
        adjust_lens(still, lens_of(400.0), CONFIG, WITH_CENTRE)


def test_of_an_ideal_lens_only_the_focal_length_is_estimated() -> None:
    adjusted = adjust_lens(views_of(lens_of(400.0), 0.2), lens_of(380.0), CONFIG, IDEAL)
    assert adjusted.lens[3:] == (0.0, 0.0)
    assert adjusted.lens.focal == pytest.approx(400.0, rel=2e-3)
