"""Right images that are taken at another time than the left ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.config import Config
from vo.base.faults import FaultKind
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.types import Bytes, Frame
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.pair_matching import PairMatcher, View
from vo.engine.frontend.stereo_time_offset import TimeOffsetEstimator
from vo.recordings.sources.registry import open_source

CONFIG = Config()
PICKS = (6, 10, 15)


@pytest.fixture(scope="module")
def rig(synthetic_stereo: Path) -> RectifiedRig:
    return rectified_rig(open_source(synthetic_stereo).rig)


@pytest.fixture(scope="module")
def frames(synthetic_stereo: Path) -> list[Frame]:
    return list(open_source(synthetic_stereo).frames())


def _turned(image: Bytes, rig: RectifiedRig) -> Bytes:
    """As seen by a camera that looks up by 0.6 degrees, and is turned by 0.4."""
    turn, _ = cv2.Rodrigues(np.deg2rad([-0.6, 0.0, 0.4]))
    matrix = rig.matrix @ np.asarray(turn) @ np.linalg.inv(rig.matrix)
    size = image.shape[::-1]
    seen = cv2.warpPerspective(image, matrix, size, None, cv2.INTER_CUBIC, cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.uint8)


def _estimated(
    rig: RectifiedRig, frames: list[Frame], late: int, *, is_turned: bool = False
) -> TimeOffsetEstimator:
    """The estimate from pairs whose right image is that of an earlier frame."""
    frontend = make_frontend(CONFIG)
    matcher = PairMatcher(frontend.matcher, frontend.patches, CONFIG.stereo.max_disparity_ratio)
    estimator = TimeOffsetEstimator(rig)
    for number in PICKS:
        left, right = frames[number].image0, frames[number - late].image1
        assert right is not None
        right = _turned(right, rig) if is_turned else right
        views = [View(image, frontend.extractor.extract(image)) for image in (left, right)]
        estimator.next_image(frames[number - 1].stamp_ns, frames[number - 1].image0)
        estimator.next_image(frames[number].stamp_ns, left)
        estimator.add(frames[number].stamp_ns, matcher.match(views[0], views[1]))
        estimator.next_image(frames[number + 1].stamp_ns, frames[number + 1].image0)
    return estimator


@pytest.mark.parametrize("is_turned", [False, True], ids=["calibrated", "turned"])
def test_images_of_the_same_time_have_no_offset(
    rig: RectifiedRig, frames: list[Frame], is_turned: bool
) -> None:
    estimator = _estimated(rig, frames, 0, is_turned=is_turned)
    assert estimator.offset_ms is None
    assert estimator.faults == ()


@pytest.mark.parametrize("late", [1, -1])
@pytest.mark.parametrize("is_turned", [False, True], ids=["calibrated", "turned"])
def test_the_offset_of_right_images_is_estimated(
    rig: RectifiedRig, frames: list[Frame], late: int, is_turned: bool
) -> None:
    interval_ms = 1e-6 * float(np.median(np.diff([frame.stamp_ns for frame in frames])))
    estimator = _estimated(rig, frames, late, is_turned=is_turned)
    assert estimator.offset_ms == pytest.approx(-late * interval_ms, rel=0.1)
    (fault,) = estimator.faults
    assert fault.kind is FaultKind.RIGHT_TIME_OFFSET and not fault.is_handled
    assert fault.value == estimator.offset_ms


def test_a_camera_that_stands_still_shows_no_offset(rig: RectifiedRig, frames: list[Frame]) -> None:
    still = [Frame(i, round(i * 5e7), frames[0].images) for i in range(20)]
    assert _estimated(rig, still, 1).offset_ms is None
