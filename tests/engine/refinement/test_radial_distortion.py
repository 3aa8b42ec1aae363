from __future__ import annotations

import numpy as np
import pytest

from vo.base.faults import FaultKind
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.types import Camera, Rig
from vo.engine.geometry.k1_error import edge_shift_px, residual_per_k1
from vo.engine.refinement.radial_distortion import RadialDistortionEstimator


def _rig(focal: float = 460.0) -> RectifiedRig:
    return rectified_rig(Rig(Camera(752, 480, focal, focal, 376.0, 240.0)))


def _corrections(
    k1: list[float], sigma: float | list[float] = 0.001, rig: RectifiedRig | None = None
) -> list[tuple[int, float]]:
    """Number of the window and k1 of each correction; what is corrected is seen no more."""
    watch, found = RadialDistortionEstimator(rig or _rig()), []
    sigmas = np.broadcast_to(sigma, len(k1)).tolist()
    for i, (value, s) in enumerate(zip(k1, sigmas, strict=True)):
        wanted = watch.update(
            CalibrationResidual(np.array([value - watch.applied]), np.array([[s**-2]]))
        )
        if wanted is not None:
            found.append((i, wanted))
    return found


@pytest.mark.parametrize("k1", [-0.01, 0.009])
def test_an_error_far_beyond_noise_is_corrected_at_the_third_window(k1: float) -> None:
    assert _corrections([k1] * 30) == [(2, pytest.approx(k1, rel=1e-3))]


def test_an_error_near_the_noise_is_corrected_when_it_has_lasted() -> None:
    ((number, wanted),) = _corrections([0.0035] * 60)
    assert 10 < number < 40
    assert wanted == pytest.approx(0.0035, rel=1e-3)


@pytest.mark.parametrize("others", [0.0, -0.006, 0.03])
def test_an_error_that_one_part_of_a_run_has_alone_is_not_corrected(others: float) -> None:
    # 3.5 standard deviations, as one part of a map that is bent; three others refute it.
    assert _corrections([0.007] * 10 + [others] * 10, [0.001] * 10 + [0.0007] * 10) == []


def test_an_error_on_which_parts_no_longer_agree_is_taken_back() -> None:
    found = _corrections([0.02] * 10 + [0.001] * 30, 0.0005)
    assert found[0] == (2, pytest.approx(0.02, rel=1e-3))
    assert found[-1][1] == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_no_error(seed: int) -> None:
    # Windows that share keyframes err together.
    waves = np.repeat(np.random.default_rng(seed).normal(0.0, 0.0012, 20), 10)
    assert _corrections(waves.tolist()) == []


def test_unsure_windows_hardly_count() -> None:
    found = _corrections([0.05] * 20 + [0.006] * 20, [0.02] * 20 + [0.0005] * 20)
    assert found[0][0] >= 20
    assert found[-1][1] == pytest.approx(0.006, abs=0.001)


def test_an_error_that_proves_to_be_none_is_taken_back() -> None:
    found = _corrections([0.009] * 5 + [-0.0004] * 100)
    assert found[0] == (2, pytest.approx(0.009, rel=1e-3))
    assert found[-1][1] == 0.0


def test_what_moves_the_corners_by_a_fifth_of_a_pixel_is_not_corrected() -> None:
    for focal in (230.0, 460.0, 920.0):
        rig = _rig(focal)
        k1 = 0.19 / edge_shift_px(rig, 1.0)
        assert _corrections([k1] * 2000, 0.01 * k1, rig) == []
        assert _corrections([5.0 * k1] * 20, 0.01 * k1, rig) == [
            (2, pytest.approx(5.0 * k1, rel=1e-3))
        ]


def test_what_a_lens_hides_at_its_edges_is_reckoned_with() -> None:
    # Ideal points look 1.8 times as bent as k1 is wrong by.
    lens = Camera(752, 480, 460.0, 460.0, 376.0, 240.0, "radtan", (-0.28, 0.07, 0.0, 0.0))
    rig = rectified_rig(Rig(lens))
    bend = residual_per_k1(rig)
    assert 1.7 < bend < 1.9
    ((_, wanted), *_) = _corrections([0.005 * bend] * 3, rig=rig)
    assert wanted == pytest.approx(0.005)


def test_a_window_may_speak_for_several() -> None:
    one, other = RadialDistortionEstimator(_rig()), RadialDistortionEstimator(_rig())
    left = CalibrationResidual(np.array([0.009]), np.array([[1e6]]))
    assert [one.update(left) is None for _ in range(3)] == [True, True, False]
    assert other.update(left, 3) is not None
    assert other.applied == pytest.approx(one.applied, rel=1e-12)


@pytest.mark.parametrize(("edge_px", "is_open"), [(12.0, False), (-25.0, True)])
def test_an_error_that_one_coefficient_cannot_correct_is_a_fault(
    edge_px: float, is_open: bool
) -> None:
    watch = RadialDistortionEstimator(_rig())
    k1 = edge_px / edge_shift_px(_rig(), 1.0)
    for _ in range(3):
        watch.update(CalibrationResidual(np.array([k1 - watch.applied]), np.array([[1e6]])))
    assert watch.applied == pytest.approx(k1, rel=1e-3)
    assert [fault.kind for fault in watch.faults] == [FaultKind.WRONG_LENS] * is_open
    assert not any(fault.is_handled for fault in watch.faults)


@pytest.mark.parametrize(
    ("bend", "sigma", "is_open"),
    [(0.05, 0.002, True), (-0.05, 0.002, True), (0.004, 0.0002, False), (0.05, 0.02, False)],
)
def test_points_that_stay_bent_make_any_correction_a_fault(
    bend: float, sigma: float, is_open: bool
) -> None:
    watch, none = RadialDistortionEstimator(_rig()), RadialDistortionEstimator(_rig())
    for _ in range(3):
        error = np.array([0.006 - watch.applied])
        watch.update(CalibrationResidual(error, np.array([[1e6]]), bend, sigma))
        none.update(CalibrationResidual(np.zeros(1), np.array([[1e6]]), bend, sigma))
    for each in (watch, none):
        assert [fault.kind for fault in each.faults] == [FaultKind.WRONG_LENS] * is_open


@pytest.mark.parametrize(
    ("bend", "sigma", "k1", "is_open"),
    [(-0.1, 0.005, -0.1, True), (0.015, 0.0003, 0.015, False), (-0.1, 0.1, 0.0, False)],
)
def test_both_lenses_of_a_pair_are_corrected_unless_they_are_quite_others(
    bend: float, sigma: float, k1: float, is_open: bool
) -> None:
    camera, beside = Camera(752, 480, 460.0, 460.0, 376.0, 240.0), np.eye(4)
    beside[0, 3] = -0.12
    watch = RadialDistortionEstimator(rectified_rig(Rig(camera, camera, beside)))
    for _ in range(6):
        left = bend - watch.applied
        watch.update(CalibrationResidual(np.zeros(2), np.eye(2), left, sigma))
    assert watch.applied == pytest.approx(k1, rel=1e-3)
    assert [fault.kind for fault in watch.faults] == [FaultKind.WRONG_LENS] * is_open


def test_lenses_of_a_pair_on_which_parts_disagree_are_a_fault() -> None:
    camera, beside = Camera(752, 480, 460.0, 460.0, 376.0, 240.0), np.eye(4)
    beside[0, 3] = -0.12
    watch = RadialDistortionEstimator(rectified_rig(Rig(camera, camera, beside)))
    for bend in [0.08] * 10 + [-0.02] * 10 + [0.08] * 30:
        watch.update(CalibrationResidual(np.zeros(2), np.eye(2), bend - watch.applied, 0.004))
    assert watch.faults
