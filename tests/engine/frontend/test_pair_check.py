"""Pairs whose images are exchanged, mirrored or turned, or of one camera only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.config import Config
from vo.base.errors import SourceError
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.types import Bytes, Floats, Frame
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.pair_check import PairCheck, disparity_signs
from vo.engine.frontend.pair_matching import PairMatcher, View
from vo.engine.frontend.same_view import is_same_view
from vo.recordings.sources.registry import open_source

CONFIG = Config()
Pair = tuple[Bytes, Bytes]


@pytest.fixture(scope="module")
def rig(synthetic_stereo: Path) -> RectifiedRig:
    return rectified_rig(open_source(synthetic_stereo).rig)


@pytest.fixture(scope="module")
def pair(synthetic_stereo: Path) -> Pair:
    frame = next(iter(open_source(synthetic_stereo).frames(0, 1, 1)))
    assert frame.image1 is not None
    return frame.image0, frame.image1


def _check(rig: RectifiedRig, *pairs: Pair) -> PairCheck:
    """A check that has seen some pairs."""
    frontend = make_frontend(CONFIG)
    matcher = PairMatcher(frontend.matcher, frontend.patches, CONFIG.stereo.max_disparity_ratio)
    check = PairCheck(rig, frontend.extractor, matcher)
    for index, (left, right) in enumerate(pairs):
        is_due = check.needs_next_pair()
        check.compare(Frame(index, index, (left, right)))
        if is_due:
            views = [View(each, frontend.extractor.extract(each)) for each in (left, right)]
            check.update(index, views[0], views[1], None)
    return check


def _flipped(image: Bytes, code: int) -> Bytes:
    return np.asarray(cv2.flip(image, code), dtype=np.uint8)


def _dark(image: Bytes) -> Bytes:
    return np.asarray(image // 30, dtype=np.uint8)


def _shifted(image: Bytes, pixels: float) -> Bytes:
    """The image with disparities that are smaller by some pixels."""
    matrix = np.array([[1.0, 0.0, pixels], [0.0, 1.0, 0.0]])
    size = image.shape[::-1]
    moved = cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, dtype=np.uint8)


def _as_jpeg(image: Bytes) -> Bytes:
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image)[1], 0), dtype=np.uint8)


def test_a_pair_that_is_right_is_checked_once(rig: RectifiedRig, pair: Pair) -> None:
    assert not _check(rig, pair).needs_next_pair()


EXCHANGED: dict[str, Callable[[Bytes, Bytes], Pair]] = {
    "exchanged": lambda left, right: (right, left),
    "both turned by 180 degrees": lambda left, right: (_flipped(left, -1), _flipped(right, -1)),
    "both mirrored": lambda left, right: (_flipped(left, 1), _flipped(right, 1)),
}


@pytest.mark.parametrize("change", list(EXCHANGED))
@pytest.mark.parametrize("dark", [0, 3])
def test_exchanged_images_are_refused_once_they_can_be_seen(
    rig: RectifiedRig, pair: Pair, change: str, dark: int
) -> None:
    left, right = EXCHANGED[change](*pair)
    first = [(_dark(left), _dark(right))] * dark
    with pytest.raises(SourceError, match=rf"exchanged.*farther right.*\(frame {dark}\)"):
        _check(rig, *first, (left, right))


@pytest.mark.parametrize(
    ("code", "how"), [(-1, "turned by 180"), (0, "top to bottom"), (1, "left to right")]
)
@pytest.mark.parametrize("side", [0, 1])
def test_one_image_that_is_mirrored_or_turned_is_refused(
    rig: RectifiedRig, pair: Pair, code: int, how: str, side: int
) -> None:
    images = list(pair)
    images[side] = _flipped(images[side], code)
    with pytest.raises(SourceError, match=f"the right image is .*{how}"):
        _check(rig, (images[0], images[1]))


@pytest.mark.parametrize("copy", [np.copy, _as_jpeg], ids=["same bytes", "compressed"])
@pytest.mark.parametrize("dark", [0, 2])
def test_one_camera_twice_is_refused(
    rig: RectifiedRig, pair: Pair, copy: Callable[[Bytes], Bytes], dark: int
) -> None:
    left = pair[0]
    first = [(_dark(left), _dark(left))] * dark
    check = _check(rig, *first, *[(left, copy(left))] * 2)
    with pytest.raises(SourceError, match="the same camera twice"):
        check.compare(Frame(dark + 2, 0, (left, copy(left))))


def test_one_repeated_image_is_no_reason_to_refuse(rig: RectifiedRig, pair: Pair) -> None:
    check = _check(rig, (pair[0], pair[0]), pair)
    for index in range(2, 6):
        check.compare(Frame(index, index, (pair[0], pair[0])))


@pytest.mark.parametrize("pixels", [-6.0, -3.0, 3.0, 6.0])
def test_a_turned_right_camera_is_not_taken_for_exchanged_images(
    rig: RectifiedRig, pair: Pair, pixels: float
) -> None:
    _check(rig, (pair[0], _shifted(pair[1], pixels)))


@pytest.mark.parametrize("pixels", [0.1, 0.3, 1.0])
def test_a_far_scene_is_not_taken_for_one_camera(
    rig: RectifiedRig, pair: Pair, pixels: float
) -> None:
    far = (pair[0], _shifted(pair[0], pixels))
    assert is_same_view(*far) is False
    _check(rig, *[far] * 4)


@pytest.mark.parametrize(
    ("disparity", "is_positive", "are_exchanged"),
    [
        (np.linspace(0.0, 60.0, 200), True, False),
        (np.linspace(-60.0, 0.0, 200), False, True),
        (np.linspace(-1.0, 1.0, 200), False, False),  # far
        (np.linspace(-4.0, 0.0, 200), False, False),  # far, with a camera that was turned
        (np.linspace(-8.0, 20.0, 200), False, False),
        (np.linspace(-60.0, 0.0, 20), False, False),  # too few
    ],
)
def test_signs_are_told_where_they_are_certain(
    disparity: Floats, is_positive: bool, are_exchanged: bool
) -> None:
    assert disparity_signs(disparity, 400.0) == (is_positive, are_exchanged)
