"""Errors of the calibration that are found and corrected during a walk."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from recorded_walk import CONFIG, Recording, Run, aligned, track

from vo.base.config import KeyframeConfig
from vo.base.faults import FaultKind
from vo.base.types import Frame, Rig
from vo.engine.backend.optimizer import DeferredOptimizer
from vo.engine.backend.window_problem import WindowProblem


def _with_shifted_right(frames: Iterable[Frame], shift_px: float) -> list[Frame]:
    """The right image is moved to the left, so that every disparity grows by `shift_px`."""
    move = np.array([[1.0, 0.0, -shift_px], [0.0, 1.0, 0.0]])
    result = []
    for frame in frames:
        assert frame.image1 is not None
        image1 = cv2.warpAffine(
            frame.image1,
            move,
            (480, 300),
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        result.append(replace(frame, images=(frame.image0, np.asarray(image1, dtype=np.uint8))))
    return result


def test_without_a_disparity_offset_none_is_found(stereo: Run) -> None:
    assert abs(stereo.odometry.calibration_errors.disparity_offset_px) < 0.1


@pytest.mark.parametrize("shift_px", [0.5, -0.5])
def test_a_disparity_offset_is_found_and_corrected(recording: Recording, shift_px: float) -> None:
    run = track(recording.rig, _with_shifted_right(recording.frames[:30], shift_px))
    assert run.odometry.calibration_errors.disparity_offset_px == pytest.approx(shift_px, abs=0.15)
    _, fit = aligned(run, recording, with_scale=True)
    assert fit.scale == pytest.approx(1.0, abs=0.02)


def test_a_disparity_offset_is_not_corrected_if_switched_off(
    recording: Recording,
) -> None:
    refinement = CONFIG.refinement.model_copy(update={"disparity_correction": False})
    frames = _with_shifted_right(recording.frames[:15], 0.5)
    run = track(recording.rig, frames, CONFIG.model_copy(update={"refinement": refinement}))
    assert run.odometry.calibration_errors.disparity_offset_px == 0.0
    _, fit = aligned(run, recording, with_scale=True)
    assert abs(fit.scale - 1.0) > 0.01  # so the shift is one that matters


def test_calibration_is_estimated_in_each_of_ten_windows_and_then_in_every_third(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimated = _estimated(monkeypatch)
    often = KeyframeConfig(max_gap_s=1e-3, min_parallax_deg=0.05)  # so that there are enough
    track(recording.rig, recording.frames, CONFIG.model_copy(update={"keyframes": often}))
    assert len(estimated) > 20
    assert estimated[:10] == [True] * 10
    assert estimated[10:] == [number % 3 == 0 for number in range(10, len(estimated))]


@pytest.mark.parametrize(
    ("mode", "setting"), [("stereo", "disparity_correction"), ("mono", "lens_correction")]
)
def test_calibration_is_not_estimated_if_its_correction_is_switched_off(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, mode: str, setting: str
) -> None:
    estimated = _estimated(monkeypatch)
    changed = {setting: False, "lens_correction": False}  # of a pair, the lens is estimated as well
    refinement = CONFIG.refinement.model_copy(update=changed)
    rig = recording.rig if mode == "stereo" else recording.mono_rig
    frames = recording.frames[:15] if mode == "stereo" else recording.mono()[:25]
    track(rig, frames, CONFIG.model_copy(update={"refinement": refinement}))
    assert estimated
    assert not any(estimated)


def _estimated(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether the calibration is estimated in each window that is submitted from here on."""
    estimated: list[bool] = []
    submit = DeferredOptimizer.submit

    def noted(self: DeferredOptimizer, problem: WindowProblem) -> None:
        estimated.append(problem.estimates_calibration)
        submit(self, problem)

    monkeypatch.setattr(DeferredOptimizer, "submit", noted)
    return estimated


def _with_k1(recording: Recording, k1: float, k2: float = 0.0) -> Rig:
    """A calibration that is wrong by k1 and k2: the lens of the recording has no distortion."""
    cam0 = recording.rig.cam0
    return Rig(replace(cam0, distortion_model="radtan", distortion=(k1, k2, 0.0, 0.0)))


def test_a_lens_that_is_as_calibrated_is_not_corrected(mono: Run) -> None:
    assert mono.odometry.calibration_errors.lens_error is None
    assert not any(estimate.faults for estimate in mono.estimates)


@pytest.mark.parametrize(("k1", "k2"), [(-0.3, 0.1), (0.25, 0.0)])
def test_quite_another_lens_is_a_fault_whatever_is_corrected(
    recording: Recording, k1: float, k2: float
) -> None:
    run = track(_with_k1(recording, k1, k2), recording.mono())
    faults = {fault for estimate in run.estimates for fault in estimate.faults}
    assert FaultKind.WRONG_LENS in {fault.kind for fault in faults}
    assert not any(fault.is_handled for fault in faults)


@pytest.mark.parametrize("k1", [-0.02, 0.02])  # half as much needs a longer recording
def test_an_error_of_the_lens_is_found_and_corrected(
    recording: Recording, mono: Run, k1: float
) -> None:
    run = track(_with_k1(recording, k1), recording.mono())
    found = run.odometry.calibration_errors.lens_error
    assert found is not None
    assert found.k1 == pytest.approx(-k1, rel=0.1)  # three pixels in the corners, or six
    radius = np.hypot(240.0, 150.0) / 264.0
    assert not any(estimate.faults for estimate in run.estimates)
    assert found.edge_px == pytest.approx(found.k1 * 264.0 * radius**3, rel=0.1)
    ate, _ = aligned(run, recording, with_scale=True)
    right, _ = aligned(mono, recording, with_scale=True)
    assert ate < 4.0 * right


def test_a_lens_is_not_corrected_if_switched_off(recording: Recording, mono: Run) -> None:
    refinement = CONFIG.refinement.model_copy(update={"lens_correction": False})
    config = CONFIG.model_copy(update={"refinement": refinement})
    run = track(_with_k1(recording, 0.02), recording.mono(), config)
    assert run.odometry.calibration_errors.lens_error is None
    ate, _ = aligned(run, recording, with_scale=True)
    right, _ = aligned(mono, recording, with_scale=True)
    assert ate > 6.0 * right  # so the error is one that matters
