from __future__ import annotations

import numpy as np
import pytest

from vo.base.faults import FaultKind
from vo.base.geometry.rectification import rectified_rig
from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.types import Camera, Rig
from vo.engine.refinement.disparity_bias import DisparityBiasEstimator

RIG = rectified_rig(Rig(Camera(1240, 376, 720.0, 720.0, 620.0, 188.0)))


def _left(offset_px: float, sigma: float, curve_px: float = 0.0) -> CalibrationResidual:
    """What a window says that is as sure of the curve as of the offset."""
    return CalibrationResidual(np.array([offset_px, curve_px]), np.eye(2) * sigma**-2)


def _corrections(offsets: list[float], sigma: float = 0.02) -> list[tuple[int, float]]:
    """Number of the window and offset of each correction; what is corrected is seen no more."""
    watch, found = DisparityBiasEstimator(RIG), []
    for i, offset in enumerate(offsets):
        wanted = watch.update(_left(offset - float(watch.applied[0]), sigma))
        if wanted is not None:
            assert wanted[1] == 0.0
            found.append((i, float(wanted[0])))
    return found


@pytest.mark.parametrize(("offset", "window"), [(-0.8, 2), (0.4, 2), (0.3, 9)])
def test_a_large_offset_is_corrected_after_a_few_windows(offset: float, window: int) -> None:
    (number, wanted), *_ = _corrections([offset] * 20)
    assert number == window
    assert wanted == pytest.approx(offset, abs=1e-9)


@pytest.mark.parametrize("offset", [-0.22, 0.18])
def test_a_small_offset_is_corrected_when_it_has_lasted(offset: float) -> None:
    (number, wanted), *_ = _corrections([offset] * 60)
    assert 20 < number < 50
    assert wanted == pytest.approx(offset, abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_what_windows_differ_by_is_no_offset(seed: int) -> None:
    # Slow waves about nothing; a real recording without an offset has some twice as high.
    waves = np.repeat(np.random.default_rng(seed).normal(0.0, 0.05, 30), 10)
    assert _corrections(waves.tolist()) == []


def test_windows_that_do_not_agree_on_a_small_offset_have_none() -> None:
    # kitti_raw, well calibrated, after which there is nothing.
    waves = [-0.04, 0.17, 0.3, 0.47, 0.34, 0.16, 0.08, 0.07, 0.0, -0.04]
    assert _corrections(waves) == []
    assert _corrections([w + 0.3 for w in waves] + [0.01] * 40) == []


def test_a_correction_that_later_windows_refute_is_taken_back() -> None:
    found = _corrections([0.8] * 10 + [-0.05] * 40)
    assert found[0] == (2, pytest.approx(0.8))
    assert found[-1][1] == 0.0
    assert found[-1][0] < 20


def test_what_later_windows_confirm_stays() -> None:
    found = _corrections([0.8] * 10 + [0.6] * 100)
    assert found[-1][1] == pytest.approx(0.62, abs=0.03)
    assert min(offset for _, offset in found) > 0.6


def test_less_than_a_tenth_of_a_pixel_is_never_corrected() -> None:
    assert _corrections([0.09] * 500) == []


def test_a_curve_is_corrected_without_an_offset() -> None:
    watch, found = DisparityBiasEstimator(RIG), []
    for i in range(20):
        wanted = watch.update(_left(0.04, 0.02, -1.2 - float(watch.applied[1])))
        if wanted is not None:
            found.append((i, wanted.tolist()))
    assert found == [(2, [0.0, pytest.approx(-1.2)])]


def test_what_a_curve_is_at_the_sides_of_the_image_counts() -> None:
    narrow = rectified_rig(Rig(Camera(1240, 376, 2880.0, 2880.0, 620.0, 188.0)))
    for rig, corrected in ((RIG, True), (narrow, False)):
        watch = DisparityBiasEstimator(rig)
        changes = [watch.update(_left(0.0, 0.02, 0.6)) is not None for _ in range(200)]
        assert any(changes) == corrected


@pytest.mark.parametrize("truth_px", [0.5, -0.5, 2.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_real_offset_is_corrected_soon_and_then_left_alone(truth_px: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = _corrections((truth_px + 0.05 * rng.standard_normal(50)).tolist(), sigma=0.05)
    assert found[0][0] <= 5
    assert found[0][1] == pytest.approx(truth_px, abs=0.15)
    assert found[-1][1] == pytest.approx(truth_px, abs=0.08)
    assert len(found) <= 5


def test_unsure_windows_change_nothing() -> None:
    noise = 0.1 * np.random.default_rng(0).standard_normal(10)
    assert _corrections((0.5 + noise).tolist(), sigma=2.0) == []


def test_sure_windows_count_more_than_unsure_ones() -> None:
    watch = DisparityBiasEstimator(RIG)
    watch.update(_left(5.0, 10.0))
    for _ in range(2):
        wanted = watch.update(_left(0.8, 0.02))
    assert wanted is not None
    assert wanted[0] == pytest.approx(0.8, abs=0.01)


def test_a_trace_of_an_offset_beside_a_curve_is_left_out() -> None:
    watch = DisparityBiasEstimator(RIG)
    for _ in range(10):
        watch.update(_left(0.13 - float(watch.applied[0]), 0.02, -1.2 - float(watch.applied[1])))
    assert watch.applied.tolist() == [0.0, pytest.approx(-1.2)]


def test_an_offset_and_a_curve_are_corrected_together() -> None:
    watch = DisparityBiasEstimator(RIG)
    for _ in range(3):
        wanted = watch.update(_left(0.6, 0.02, -1.2))
    assert wanted is not None
    assert wanted.tolist() == [pytest.approx(0.6), pytest.approx(-1.2)]


def test_a_window_may_speak_for_several() -> None:
    one, other = DisparityBiasEstimator(RIG), DisparityBiasEstimator(RIG)
    left = _left(0.6, 0.02, -1.2)
    assert [one.update(left) is None for _ in range(3)] == [True, True, False]
    assert other.update(left, 3) is not None
    assert other.applied == pytest.approx(one.applied, rel=1e-12)


@pytest.mark.parametrize(("offset", "curve"), [(3.2, 0.0), (-343.0, 0.0), (0.5, 12.0)])
def test_an_error_beyond_those_of_a_slightly_wrong_calibration_is_not_corrected(
    offset: float, curve: float
) -> None:
    watch = DisparityBiasEstimator(RIG)
    for _ in range(20):
        assert watch.update(_left(offset, 0.02, curve)) is None
    assert watch.applied.tolist() == [0.0, 0.0]
    side = float(np.square(620.0 / 720.0))
    (fault,) = watch.faults
    assert fault.kind is FaultKind.WRONG_STEREO_CALIBRATION
    assert not fault.is_handled
    assert fault.value == pytest.approx(curve * side if curve else offset)


def test_rows_that_confirm_a_yaw_allow_a_larger_offset() -> None:
    watch = DisparityBiasEstimator(RIG)
    for _ in range(3):
        wanted = watch.update(_left(-5.0, 0.02), skew_px=5.0)
    assert wanted is not None
    assert wanted[0] == pytest.approx(-5.0)
    assert watch.faults == ()


def test_a_correction_that_grows_beyond_what_is_plausible_is_taken_back() -> None:
    watch = DisparityBiasEstimator(RIG)
    for _ in range(3):
        watch.update(_left(2.8, 0.02))
    assert watch.applied[0] == pytest.approx(2.8)
    for _ in range(10):
        watch.update(_left(9.0 - float(watch.applied[0]), 0.02))
    assert watch.applied.tolist() == [0.0, 0.0]
    assert watch.faults[0].value > 3.0
