"""Single lenses that are wider than a pinhole camera: several views from one place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from rig_walks import CAMERA, Walk, ate, edited, render, track

from vo.base.config import load_config
from vo.base.geometry.cameras import equirectangular
from vo.base.images.image_circle import circle_mask
from vo.base.types import Camera, Frame, Rig
from vo.engine.rig.creation import is_tracked_as_rig
from vo.engine.rig.views import rig_views

FISHEYE = Camera(320, 320, 96.5, 96.5, 159.5, 159.5, "equidistant", (0.0,) * 4)  # 190°
PANORAMA = equirectangular(512, 256)


@pytest.fixture(scope="module", params=["fisheye", "panorama"])
def wide(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Four seconds in a room by hand."""
    lens = FISHEYE if request.param == "fisheye" else PANORAMA
    settings = ["world=room", "motion=handheld", "seconds=4", "fps=10"]
    return render(Rig(lens), tmp_path_factory.mktemp("wide"), settings)


def test_one_wide_lens_gives_a_path_without_scale(wide: Walk) -> None:
    estimates, path = track(wide.rig, wide.frames)
    assert len(path) == len(wide.frames)
    assert ate(path, wide.truth, with_scale=True) < 0.004  # of 3.4 m
    assert all(estimate.segment == 0 for estimate in estimates)
    assert np.median([estimate.inliers for estimate in estimates]) > 300


def test_a_wall_before_half_of_the_view_does_no_harm(wide: Walk) -> None:
    def cover(frame: Frame) -> Frame:
        image = frame.image0.copy()
        if 15 <= frame.index < 30:
            image[:, image.shape[1] // 2 :] = 120
        return replace(frame, images=(image,))

    _, path = track(wide.rig, edited(wide.frames, cover))
    assert len(path) == len(wide.frames)
    assert ate(path, wide.truth, with_scale=True) < 0.01


@pytest.mark.parametrize(("lens", "count"), [(FISHEYE, 5), (PANORAMA, 6), (CAMERA, 1)])
def test_views_look_around_from_one_place(lens: Camera, count: int) -> None:
    views = rig_views(Rig(lens))
    assert len(views.views) == count
    assert not views.body_from_views[:, :3, 3].any()
    axes = views.body_from_views[:, :3, 2]
    cosines = axes @ axes.T
    assert np.allclose(np.diag(cosines), 1.0)
    assert np.all(np.isclose(cosines, [[0.0]], atol=1e-9) | np.isclose(abs(cosines), 1.0))


def test_a_view_has_what_the_lens_sees_behind_itself() -> None:
    views = rig_views(Rig(FISHEYE)).views
    sees = [1.0 if view.mask is None else float(np.mean(view.mask > 0)) for view in views]
    assert sees[0] > 0.95
    assert all(0.35 < ratio < 0.6 for ratio in sees[1:])


@pytest.mark.parametrize(
    ("rig", "overrides", "has_sensor", "expected"),
    [
        (Rig(FISHEYE), [], False, True),
        (Rig(FISHEYE), [], True, False),
        (Rig(FISHEYE), ["camera.field_of_view=whole"], True, True),
        (Rig(FISHEYE), ["camera.field_of_view=cropped"], False, False),
        (Rig(FISHEYE), ["memory.map=a.vomap"], False, False),
        (Rig(replace(FISHEYE, readout_s=0.02)), [], False, False),
        (Rig(FISHEYE, has_depth=True), ["camera.field_of_view=whole"], False, False),
        (Rig(replace(FISHEYE, fx=150.0, fy=150.0)), [], False, False),  # 122°
        (Rig(PANORAMA), ["camera.field_of_view=cropped"], True, True),
        (Rig(CAMERA), ["camera.field_of_view=whole"], False, False),
    ],
)
def test_which_lenses_are_tracked_whole(
    rig: Rig, overrides: Sequence[str], has_sensor: bool, expected: bool
) -> None:
    config = load_config(overrides=overrides)
    assert is_tracked_as_rig(rig, config, has_sensor=has_sensor) is expected


def test_the_black_surround_of_a_fisheye_image_is_found() -> None:
    rng = np.random.default_rng(1)
    lens = replace(FISHEYE, width=480, cx=250.0)
    scene = rng.integers(30, 255, (320, 480)).astype(np.uint8)
    v, u = np.mgrid[:320, :480]
    inside = np.hypot(u - lens.cx, v - lens.cy) < 150.0
    mask = circle_mask(np.where(inside, scene, np.uint8(5)), lens)
    assert mask is not None
    assert (mask[~inside] == 0).mean() > 0.9 and (mask[inside] == 255).all()
    dark = scene.copy()
    dark[200:] = 5  # a dark floor is no circle
    for image in (scene, dark, np.full_like(scene, 5), scene // 16):
        assert circle_mask(image, lens) is None
