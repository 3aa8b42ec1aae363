"""Methods by name: what they match, what they refuse, and which there are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vo
from vo.base.config import load_config
from vo.base.errors import ConfigError
from vo.base.types import Bytes
from vo.engine.features.detectors import DETECTORS, available_detectors
from vo.tools.laboratory.methods import Method, all_methods, expand, make_method, missing_detectors

SHIFT_PX = 7
CONFIG = load_config("default", ["features.count=500"])
_LEARNED = {name for name, kind in DETECTORS.items() if kind.model}


def method(name: str) -> Method:
    return make_method(name, CONFIG.features, CONFIG.matching)


@pytest.fixture(scope="module")
def image(synthetic_stereo: Path) -> Bytes:
    return next(iter(vo.open(synthetic_stereo, mode="mono").frames())).image0


@pytest.mark.parametrize("name", all_methods())
def test_matches_of_a_shifted_image_are_shifted(name: str, image: Bytes) -> None:
    left, right = image[:, :-SHIFT_PX], image[:, SHIFT_PX:]
    found = method(name).match(left, right)
    away = np.linalg.norm(found.first - [SHIFT_PX, 0] - found.second, axis=1)
    assert len(found.first) > 20
    # Matches of learned features have no ratio test, and cells of 8 pixels do not move with it.
    assert np.mean(away < 1.5) > (0.7 if name.partition("/")[0] in _LEARNED else 0.95)
    assert found.first.shape == found.second.shape
    assert max(found.counts) <= 501  # ORB rounds the number of each level
    assert found.extract_ms > 0


@pytest.mark.parametrize("name", ["orb", "klt", "sift"])
def test_no_feature_lies_where_the_mask_is_0(name: str, image: Bytes) -> None:
    mask = np.full(image.shape, 255, np.uint8)
    mask[:, :150] = 0
    found = method(name)
    assert found.detect(image, mask)[:, 0].min() > 148
    assert found.match(image, image, mask).first[:, 0].min() > 148
    keypoints = found.extract(image, mask)
    np.testing.assert_array_equal(keypoints.xy.astype(np.float64), found.detect(image, mask))
    assert found.sizes(keypoints).min() > 2


@pytest.mark.parametrize("name", ["orb", "klt", "fast/klt", "sift", "mser", "harris"])
@pytest.mark.parametrize("shape", [(1, 1), (15, 400), (120, 160)])
def test_images_without_texture_or_size_have_no_matches(name: str, shape: tuple[int, int]) -> None:
    black = np.zeros(shape, np.uint8)
    found = method(name).match(black, black)
    assert (len(found.first), found.counts) == (0, (0, 0))


def test_optical_flow_needs_images_of_one_size(image: Bytes) -> None:
    with pytest.raises(ConfigError, match=r"needs images of one size, not \d+x\d+ and \d+x\d+"):
        method("klt").match(image, image[:, 1:])
    assert len(method("sift").match(image, image[:, 1:]).first) > 100


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("sfit", "method 'sfit': there is no detector 'sfit'; known are orb, "),
        ("sift/best", "there is no matcher 'best'; known are auto, brute_force, "),
        ("sift+hog", "there is no descriptor 'hog'"),
        ("fast+sift/klt", "optical flow needs no descriptor"),
        ("orb/klt", "choose corners such as fast/klt"),
        ("klt/flann", "write klt alone, or DETECTOR/klt"),
        ("orb+sift", "features.detector 'orb' has its own descriptor"),
        ("", "there is no detector ''"),
        ("surf", "detector 'surf' is patented"),
    ],
)
def test_unknown_methods_are_refused(name: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        method(name)
    assert message in str(error.value)


def test_all_stands_for_what_the_installation_has() -> None:
    everything = expand(["sift", "all"])
    assert everything[0] == "sift"
    assert len(set(everything)) == len(everything)
    assert {"orb", "klt", "fast/klt", *available_detectors()} <= set(everything)
    assert set(missing_detectors()) == set(DETECTORS) - _LEARNED - {"orb", *available_detectors()}
    assert not set(missing_detectors()) & set(everything)
