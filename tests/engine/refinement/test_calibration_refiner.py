"""Corrections of the calibration from the residuals of windows."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.config import RefinementConfig
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.types import Camera, Rig
from vo.engine.refinement.calibration_refiner import (
    CalibrationRefiner,
    Correction,
    DisparityCorrection,
    RadialDistortionCorrection,
)

CAMERA = Camera(1240, 376, 720.0, 720.0, 620.0, 188.0)
BESIDE = np.eye(4)
BESIDE[0, 3] = -0.54
MONO = rectified_rig(Rig(CAMERA))
STEREO = rectified_rig(Rig(CAMERA, CAMERA, BESIDE))

# Of a yaw that makes an offset of 0.6 px, and of half as many again and four times as much.
YAW, NEARLY_YAW, NO_YAW = -0.6, -0.9, -2.4


def _refiner(
    *, stereo: bool, has_depth: bool = False, config: RefinementConfig | None = None
) -> CalibrationRefiner:
    rig = STEREO if stereo else MONO
    return CalibrationRefiner(rig, config or RefinementConfig(), has_depth=has_depth)


def _residual(stereo: bool) -> CalibrationResidual:
    if stereo:
        return CalibrationResidual(np.array([0.6, -1.2]), np.eye(2) * 0.02**-2)
    return CalibrationResidual(np.array([0.012]), np.array([[1e6]]))


def _third(refiner: CalibrationRefiner, stereo: bool, skew_px: float | None) -> Correction | None:
    """The correction after three windows, none after the two before."""
    vertical = None if skew_px is None else VerticalDisparity(skew_px=skew_px)
    assert [refiner.update(_residual(stereo), 1, vertical) for _ in range(2)] == [None, None]
    return refiner.update(_residual(stereo), 1, vertical)


@pytest.mark.parametrize("stereo", [True, False])
def test_the_first_windows_are_all_evaluated_and_then_every_third_for_three(stereo: bool) -> None:
    refiner = _refiner(stereo=stereo)
    assert [refiner.window_weight(number) for number in range(10)] == [1] * 10
    assert [refiner.window_weight(number) for number in range(10, 16)] == [0, 0, 3, 0, 0, 3]


@pytest.mark.parametrize(
    ("stereo", "is_on"),
    [
        (True, {"disparity_correction": True, "lens_correction": True}),
        (False, {"disparity_correction": False, "lens_correction": True}),
    ],
)
def test_each_correction_can_be_switched_off_alone(stereo: bool, is_on: dict[str, bool]) -> None:
    for key in is_on:
        refiner = _refiner(stereo=stereo, config=RefinementConfig(**{k: k == key for k in is_on}))
        assert [refiner.window_weight(n) > 0 for n in (0, 12)] == [is_on[key]] * 2


def test_lenses_of_a_pair_are_corrected_before_the_disparities_that_they_spoil() -> None:
    refiner = _refiner(stereo=True)
    wrong = _residual(True)._replace(bend=0.02, bend_sigma=0.001)
    assert [refiner.update(wrong, 1, None) for _ in range(2)] == [None, None]
    found = refiner.update(wrong, 1, None)
    assert isinstance(found, RadialDistortionCorrection)
    assert found.k1 == pytest.approx(0.02, rel=1e-3)
    # What the uncorrected lenses did to disparities is forgotten.
    right = CalibrationResidual(np.zeros(2), np.eye(2) * 0.02**-2, 0.0, 0.001)
    assert [refiner.update(right, 1, None) for _ in range(20)] == [None] * 20
    assert not refiner.faults


def test_disparities_of_a_depth_camera_are_not_evaluated() -> None:
    refiner = _refiner(stereo=True, has_depth=True)
    assert [refiner.window_weight(number) for number in range(20)] == [0] * 20


@pytest.mark.parametrize(
    ("skew_px", "is_yaw"), [(None, False), (YAW, True), (NEARLY_YAW, True), (NO_YAW, False)]
)
def test_a_disparity_bias_is_a_yaw_only_with_the_skew_of_one(
    skew_px: float | None, is_yaw: bool
) -> None:
    correction = _third(_refiner(stereo=True), True, skew_px)
    assert correction == DisparityCorrection(
        pytest.approx(0.6),
        pytest.approx(-1.2),
        is_yaw,  # type: ignore[arg-type]
    )


def test_a_single_camera_gets_a_correction_of_its_lens() -> None:
    correction = _third(_refiner(stereo=False), False, None)
    assert correction == RadialDistortionCorrection(
        pytest.approx(0.012, rel=1e-3)  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("stereo", [True, False])
def test_a_window_stands_for_as_many_as_its_weight(stereo: bool) -> None:
    assert _refiner(stereo=stereo).update(_residual(stereo), 3, None) is not None


@pytest.mark.parametrize("stereo", [True, False])
def test_windows_with_misleading_keyframes_are_not_evaluated(stereo: bool) -> None:
    refiner = _refiner(stereo=stereo)
    assert [refiner.window_weight(number) for number in range(3)] == [1] * 3
    refiner.suspend()
    # Nor is the window that has been submitted but not solved yet.
    assert refiner.update(_residual(stereo), 3, None) is None
    assert [refiner.window_weight(number) for number in range(3, 15)] == [0] * 9 + [3, 0, 0]
