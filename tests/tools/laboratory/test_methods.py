"""Names of methods, features of one image and their spread, and homographies from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vo
from vo.base.config import load_config
from vo.base.errors import ConfigError, SourceError
from vo.base.types import Bytes
from vo.engine.features.detectors import DETECTORS, available_detectors
from vo.tools.laboratory.examination import spread
from vo.tools.laboratory.images import is_image, read_homography
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


def test_spread_is_the_ratio_of_cells_with_a_point() -> None:
    shape = (80, 160)  # 16 x 8 cells of 10 pixels
    v, u = np.mgrid[5:80:10, 5:160:10]
    every = np.column_stack([u.ravel(), v.ravel()]).astype(np.float32)
    assert spread(every, shape) == 1
    assert spread(every[:64], shape) == 0.5
    assert spread(np.repeat(every[:1], 9, axis=0), shape) == 1 / 128
    assert spread(np.empty((0, 2), np.float32), (1, 1)) == 0
    corners = np.array([[-0.5, -0.5], [159.5, 79.5]], np.float32)
    assert spread(corners, shape) == 2 / 128


@pytest.mark.parametrize("text", ["1 0 5\n0 1 0\n0 0 1\n", "1, 0, 5, 0, 1, 0, 0, 0, 1"])
def test_a_homography_is_nine_numbers(text: str, tmp_path: Path) -> None:
    path = tmp_path / "H"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_homography(path), [[1, 0, 5], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("text", ["", "1 2 3", "a b c d e f g h i", "nan 0 0 0 1 0 0 0 1"])
def test_other_texts_are_no_homography(text: str, tmp_path: Path) -> None:
    path = tmp_path / "H"
    with pytest.raises(SourceError, match="No such file"):
        read_homography(path)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SourceError, match="not nine numbers|no inverse"):
        read_homography(path)


def test_images_are_known_by_their_suffix(tmp_path: Path) -> None:
    assert is_image(Path("a.PNG"))
    assert not is_image(Path("a/*.png"))
    assert not is_image(Path("a.mp4"))
    (tmp_path / "folder.png").mkdir()
    assert not is_image(tmp_path / "folder.png")
