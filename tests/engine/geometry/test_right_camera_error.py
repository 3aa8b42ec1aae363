"""When vertical disparities are corrected."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.vertical_disparity_model import FittedVerticalDisparity, VerticalDisparity
from vo.base.types import Camera, Rig
from vo.engine.geometry.k1_error import edge_shift_px, residual_per_k1
from vo.engine.geometry.right_camera_error import is_large, is_plausible, is_worth_correcting

CAMERA = Camera(1240, 376, 720.0, 720.0, 620.0, 188.0)
BESIDE = np.eye(4)
BESIDE[0, 3] = -0.54
RIG = rectified_rig(Rig(CAMERA, CAMERA, BESIDE))


def _fitted(sigma_zoom_px: float = 0.05, **errors: float) -> FittedVerticalDisparity:
    covariance = np.diag(np.square([0.05, 0.05, sigma_zoom_px, 0.05, 0.2]))
    return FittedVerticalDisparity(VerticalDisparity(**errors), covariance)


@pytest.mark.parametrize(
    ("errors", "is_worth"),
    [
        ({"pitch_px": 0.6}, True),
        ({"pitch_px": 0.3}, False),
        ({"zoom_px": 0.8}, True),
        ({"skew_px": 6.0}, False),
        ({"skew_px": 10.0}, True),
    ],
)
def test_errors_are_corrected_from_half_a_pixel_and_skew_from_two(
    errors: dict[str, float], is_worth: bool
) -> None:
    assert is_worth_correcting(_fitted(**errors), RIG) == is_worth


def test_a_skew_that_is_certain_makes_no_other_error_certain() -> None:
    # KITTI's pairs have such a skew; an uncertain zoom beside it would bend all disparities.
    assert not is_worth_correcting(_fitted(0.5, zoom_px=0.8, skew_px=6.0), RIG)
    assert is_worth_correcting(_fitted(0.2, zoom_px=0.8, skew_px=6.0), RIG)


@pytest.mark.parametrize(
    ("pitch_px", "expected"), [(1.0, (False, True)), (2.0, (True, True)), (20.0, (True, False))]
)
def test_errors_that_cannot_wait_and_errors_that_are_implausible(
    pitch_px: float, expected: tuple[bool, bool]
) -> None:
    error = VerticalDisparity(pitch_px=pitch_px)
    assert (is_large(error, RIG), is_plausible(error, RIG)) == expected


def _rig(*distortion: float) -> RectifiedRig:
    model = "radtan" if distortion else "none"
    lens = Camera(640, 400, 420.0, 420.0, 319.5, 199.5, model, distortion)
    return rectified_rig(Rig(lens))


def test_an_error_moves_the_corners_by_the_cube_of_their_radius() -> None:
    radius = np.hypot(319.5, 199.5) / 420.0
    assert edge_shift_px(_rig(), 0.01) == pytest.approx(0.01 * 420.0 * radius**3, rel=1e-6)


def test_a_lens_that_does_not_reach_the_corners_has_a_finite_shift() -> None:
    assert 0.0 < edge_shift_px(_rig(-0.4, 0.0, 0.0, 0.0), 0.01) < 10.0


def test_without_distortion_the_residual_is_that_of_the_image() -> None:
    assert residual_per_k1(_rig()) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    "distortion", [(-0.28, 0.07, 0.0, 0.0), (0.26, -0.95, -0.005, 0.0026, 1.16)]
)
def test_undistortion_scales_the_residual(
    distortion: tuple[float, ...],
) -> None:
    rig = _rig(*distortion)
    xy = np.random.default_rng(0).uniform((0.0, 0.0), (639.0, 399.0), (500, 2))
    ideal, wrong = rig.undistort(xy), rig.with_k1_error(0.002).undistort(xy)
    ray = (ideal - (319.5, 199.5)) / 420.0
    predicted = ideal - 0.002 * residual_per_k1(rig) * 420.0 * ray * np.sum(
        ray**2, axis=1, keepdims=True
    )
    remaining, before = (np.linalg.norm(at - wrong, axis=1) for at in (predicted, ideal))
    assert np.sqrt(np.mean(remaining**2)) < 0.35 * np.sqrt(np.mean(before**2))
