"""The views of lenses of any kind, which all have the same intrinsics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rig_walks import CAMERA, FORWARD_PAIR_AND_SIDES, at

from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, MountedCamera, Rig
from vo.engine.rig.views import rig_views

FISHEYE = Camera(400, 400, 143.24, 143.24, 199.5, 199.5, "equidistant", (-0.01, 0.002, -0.001, 0))


def test_equal_pinhole_cameras_stay_as_they_are() -> None:
    views = rig_views(FORWARD_PAIR_AND_SIDES)
    assert [view.camera for view in views.views] == [0, 1, 2, 3]
    assert all(view.maps is None and view.mask is None for view in views.views)
    assert np.allclose(views.body_from_views, FORWARD_PAIR_AND_SIDES.cam0_from_cams)


@pytest.mark.parametrize(
    ("lens", "yaw_deg", "half_deg"),
    # As wide as the lens shows, at most 50 degrees to each side.
    [(FISHEYE, 39.5, 40.5), (replace(FISHEYE, fx=100.0, fy=100.0), 49.0, 50.0)],
)
def test_a_wide_lens_becomes_two_views_to_the_sides(
    lens: Camera, yaw_deg: float, half_deg: float
) -> None:
    views = rig_views(Rig(lens, lens, inverse(at(180, 0, -0.1))))
    assert [view.camera for view in views.views] == [0, 0, 1, 1]
    axes = views.rectified.cam0_from_rectified[:3, :3] @ views.body_from_views[:, :3, 2].T
    found = np.rad2deg(np.arctan2(axes[0], axes[2])) % 360
    expected = np.array([-yaw_deg, yaw_deg, 180 - yaw_deg, 180 + yaw_deg]) % 360
    assert np.allclose(found, expected, atol=0.6)
    assert np.allclose(views.body_from_views[0], np.eye(4))
    half_width = np.rad2deg(np.arctan(views.rectified.cx / views.rectified.fx))
    assert half_width == pytest.approx(half_deg, abs=0.6)


def test_lenses_of_different_size_have_common_views() -> None:
    other = replace(
        CAMERA,
        width=400,
        fx=180.0,
        fy=180.0,
        cx=199.5,
        distortion_model="radtan",
        distortion=(-0.1, 0.01, 0.0, 0.0),
    )
    views = rig_views(
        Rig(CAMERA, other, inverse(at(0, 0.2)), further=(MountedCamera(CAMERA, at(90)),))
    )
    sizes = {
        view.rectify(np.zeros((240, width), np.uint8)).shape
        for view, width in zip(views.views, (320, 400, 320), strict=True)
    }
    assert sizes == {(views.rectified.height, views.rectified.width)}
