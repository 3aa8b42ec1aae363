"""When vertical disparities are corrected."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.vertical_disparity_model import FittedVerticalDisparity, VerticalDisparity
from vo.base.types import Camera, Rig
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
