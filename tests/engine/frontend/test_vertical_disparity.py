"""Pairs whose right camera was turned after it had been calibrated."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.config import Config, StereoConfig
from vo.base.faults import FaultKind
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.types import Bytes
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.pair_matching import View
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.geometry.right_camera_error import right_camera_error
from vo.engine.refinement.disparity_bias import is_from_yaw
from vo.recordings.sources.registry import open_source

CONFIG = Config()
INSIDE = np.s_[20:-20, 20:-20]


@pytest.fixture(scope="module")
def rig(synthetic_stereo: Path) -> RectifiedRig:
    return rectified_rig(open_source(synthetic_stereo).rig)


@pytest.fixture(scope="module")
def pair(synthetic_stereo: Path) -> tuple[Bytes, Bytes]:
    frame = next(iter(open_source(synthetic_stereo).frames(0, 1, 1)))
    assert frame.image1 is not None
    return frame.image0, frame.image1


def _view(image: Bytes) -> View:
    return View(image, make_frontend(CONFIG).extractor.extract(image))


def _seen_by_turned(image: Bytes, rig: RectifiedRig, pitch_deg: float, roll_deg: float) -> Bytes:
    """The image of a camera that looks up and is turned counter-clockwise."""
    turn, _ = cv2.Rodrigues(np.deg2rad([-pitch_deg, 0.0, roll_deg]))
    matrix = rig.matrix @ np.asarray(turn) @ np.linalg.inv(rig.matrix)
    size = image.shape[::-1]
    seen = cv2.warpPerspective(image, matrix, size, None, cv2.INTER_CUBIC, cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.uint8)


def _correction(
    rig: RectifiedRig, config: StereoConfig = CONFIG.stereo
) -> VerticalDisparityCorrection:
    frontend = make_frontend(CONFIG)
    return VerticalDisparityCorrection(rig, frontend.matcher, frontend.patches, config)


def _learned(left: Bytes, right: Bytes, rig: RectifiedRig) -> VerticalDisparityCorrection:
    alignment = _correction(rig)
    assert alignment.needs_next_pair()
    assert alignment.update(_view(left), _view(right)) == (
        alignment.corrected != VerticalDisparity()
    )
    return alignment


def test_a_pair_that_is_right_is_left_alone(pair: tuple[Bytes, Bytes], rig: RectifiedRig) -> None:
    alignment = _learned(*pair, rig)
    assert alignment.corrected == VerticalDisparity()
    assert alignment.aligned_rig() is rig
    assert right_camera_error(alignment.corrected, rig) is None
    assert alignment.estimated is not None
    assert alignment.estimated[:2] == pytest.approx((0.0, 0.0), abs=0.05)


@pytest.mark.parametrize("angles", [(0.5, 0.0), (-2.0, 0.0), (0.0, 0.5), (0.0, -1.0), (-0.6, 0.8)])
def test_a_turned_camera_is_found_and_turned_back(
    pair: tuple[Bytes, Bytes], rig: RectifiedRig, angles: tuple[float, float]
) -> None:
    left, right = pair
    seen = _seen_by_turned(right, rig, *angles)
    alignment = _learned(left, seen, rig)
    found = right_camera_error(alignment.corrected, rig)
    assert found is not None
    assert (found.pitch_deg, found.roll_deg) == pytest.approx(angles, abs=0.04)
    assert found.yaw_deg == 0.0
    back = alignment.aligned_rig().rectify(seen, 1)
    before = np.abs(seen[INSIDE].astype(float) - right[INSIDE]).mean()
    after = np.abs(back[INSIDE].astype(float) - right[INSIDE]).mean()
    assert after < 2.5 < before  # it is sampled twice
    np.testing.assert_array_equal(alignment.aligned_rig().rectify(left, 0), left)


def test_rows_too_far_apart_for_a_slightly_wrong_calibration_are_a_fault(
    pair: tuple[Bytes, Bytes], rig: RectifiedRig
) -> None:
    alignment = _learned(pair[0], _seen_by_turned(pair[1], rig, 3.0, 0.0), rig)
    assert alignment.corrected == VerticalDisparity()
    (fault,) = alignment.faults
    assert fault.kind is FaultKind.DIFFERENT_ROWS
    assert not fault.is_handled
    assert fault.value == pytest.approx(np.deg2rad(3.0) * rig.fx * 1.32, rel=0.1)


def test_a_pair_without_features_says_nothing_and_others_are_asked(
    pair: tuple[Bytes, Bytes], rig: RectifiedRig
) -> None:
    grey = np.full_like(pair[0], 100)
    alignment = _learned(grey, grey, rig)
    assert alignment.estimated is None
    assert alignment.needs_next_pair()
    alignment.update(_view(pair[0]), _view(_seen_by_turned(pair[1], rig, 0.5, 0.0)))
    assert alignment.corrected.pitch_px > 1.0


def test_one_does_not_ask_for_ever(rig: RectifiedRig, pair: tuple[Bytes, Bytes]) -> None:
    grey = _view(np.full_like(pair[0], 100))
    alignment = _correction(rig)
    asked = 0
    for _ in range(100):
        if alignment.needs_next_pair():
            alignment.update(grey, grey)
            asked += 1
    assert asked == 30
    assert alignment.aligned_rig() is rig


def test_in_the_dark_pairs_are_not_asked_more_often(
    rig: RectifiedRig, pair: tuple[Bytes, Bytes]
) -> None:
    alignment, grey = _learned(*pair, rig), _view(np.full_like(pair[0], 100))
    asked = []
    for number in range(2, 32):
        if alignment.needs_next_pair():
            asked.append(number)
            alignment.update(grey, grey)
    assert asked == [3, 7, 15, 31]


def test_pairs_are_asked_ever_more_seldom_and_the_first_error_fades(
    rig: RectifiedRig, pair: tuple[Bytes, Bytes]
) -> None:
    """As where the cameras were not triggered together while they turned."""
    left, right = pair
    alignment, found = _correction(rig), {}
    for number in range(1, 32):
        if alignment.needs_next_pair():
            seen = _seen_by_turned(right, rig, 0.4 if number == 1 else 0.2, 0.0)
            aligned = alignment.aligned_rig().rectify(seen, 1)
            alignment.update(_view(left), _view(aligned))
            camera = right_camera_error(alignment.corrected, rig)
            found[number] = None if camera is None else camera.pitch_deg
    assert list(found) == [1, 3, 7, 15, 31]
    assert found[1] == pytest.approx(0.4, abs=0.03)
    assert found[31] == pytest.approx(0.2, abs=0.05)


def test_small_errors_are_corrected_when_two_further_pairs_confirm_them(
    rig: RectifiedRig, pair: tuple[Bytes, Bytes]
) -> None:
    left, right = pair
    alignment, found = _correction(rig), {}
    for number in range(1, 32):
        if alignment.needs_next_pair():
            seen = _seen_by_turned(right, rig, 0.2, 0.0)
            aligned = alignment.aligned_rig().rectify(seen, 1)
            alignment.update(_view(left), _view(aligned))
            found[number] = alignment.corrected.pitch_px
    assert [found[1], found[3]] == [0.0, 0.0]
    truth_px = float(np.deg2rad(0.2)) * rig.fx
    assert [found[n] for n in (7, 15, 31)] == pytest.approx([truth_px] * 3, abs=0.1)


def test_small_errors_that_change_from_pair_to_pair_are_not_corrected(
    rig: RectifiedRig, pair: tuple[Bytes, Bytes]
) -> None:
    """As where the right camera is triggered late, and the cameras turn."""
    left, right = pair
    alignment = _correction(rig)
    for number in range(1, 64):
        if alignment.needs_next_pair():
            sign = 1.0 if number in (1, 7, 31) else -1.0
            alignment.update(_view(left), _view(_seen_by_turned(right, rig, 0.2 * sign, 0.0)))
            assert alignment.corrected == VerticalDisparity()


def test_a_correction_that_later_pairs_refute_is_taken_back(
    rig: RectifiedRig, pair: tuple[Bytes, Bytes]
) -> None:
    left, right = pair
    alignment = _correction(rig)
    for number in range(1, 16):
        if alignment.needs_next_pair():
            seen = _seen_by_turned(right, rig, 0.5, 0.0) if number == 1 else right
            aligned = alignment.aligned_rig().rectify(seen, 1)
            alignment.update(_view(left), _view(aligned))
            is_corrected = alignment.corrected != VerticalDisparity()
            assert is_corrected == (number == 1)


def test_swapped_images_are_not_corrected(pair: tuple[Bytes, Bytes], rig: RectifiedRig) -> None:
    left, right = pair
    assert _learned(right, left, rig).corrected == VerticalDisparity()


def test_it_can_be_switched_off(rig: RectifiedRig) -> None:
    stereo = CONFIG.stereo.model_copy(update={"row_correction": False})
    assert not _correction(rig, stereo).needs_next_pair()


@pytest.mark.parametrize(
    ("offset_px", "skew_px", "is_yaw"),
    [
        (-1.1, 1.2, True),
        (0.9, -1.2, True),
        (-0.21, 6.7, False),
        (1.1, 1.2, False),
        (-1.0, 0, False),
    ],
)
def test_an_offset_is_laid_to_yaw_if_rows_confirm_it(
    offset_px: float, skew_px: float, is_yaw: bool
) -> None:
    assert is_from_yaw(offset_px, skew_px) == is_yaw
