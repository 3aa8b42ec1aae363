"""Every detector and descriptor of this installation, on a rendered image and on a moved one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest

import vo
from vo.base.config import DetectorName, FeaturesConfig, load_config
from vo.base.types import Bytes, Keypoints
from vo.engine.features.descriptors import DESCRIPTORS, available_descriptors, root_sift
from vo.engine.features.detectors import DETECTORS, available_detectors
from vo.engine.features.extractor import make_extractor
from vo.engine.features.opencv import has_algorithm
from vo.engine.learned.catalog import MODELS

COUNT = 500
SHIFT_PX = 7
ALWAYS = {"harris", "shi_tomasi", "fast", "opencv_orb", "sift", "mser"}


def config(**values: object) -> FeaturesConfig:
    return load_config("default", [f"features.{k}={v}" for k, v in values.items()]).features


@pytest.fixture(scope="module")
def image(synthetic_stereo: Path) -> Bytes:
    return next(iter(vo.open(synthetic_stereo).frames())).image0


def test_the_plain_package_of_opencv_has_these() -> None:
    assert set(available_detectors()) >= ALWAYS
    assert set(available_descriptors()) >= {"rbrief", "sift", "rootsift", "opencv_orb"}


def test_settings_and_the_table_know_the_same_detectors() -> None:
    assert set(DETECTORS) == set(get_args(DetectorName))
    assert all((kind.find is None) != (kind.extract is None) for kind in DETECTORS.values())
    assert all(kind.model in MODELS for kind in DETECTORS.values() if kind.model)


@pytest.mark.parametrize("name", available_detectors())
def test_a_detector_finds_the_same_places_in_a_shifted_image(name: str, image: Bytes) -> None:
    extractor = make_extractor(config(detector=name, count=COUNT, selection="strongest"))
    left, right = image[:, :-SHIFT_PX], image[:, SHIFT_PX:]
    a, b = extractor.extract(left), extractor.extract(right)
    assert 0 < len(a) <= COUNT
    assert (len(a.descriptor), a.descriptor.dtype) == (len(a), extractor.descriptor_format.dtype)
    extractor.descriptor_format.check(a.descriptor)
    moved = a.xy - [SHIFT_PX, 0]
    inside = (moved > 20).all(axis=1) & (moved < np.array(right.shape[::-1]) - 20).all(axis=1)
    away = np.linalg.norm(moved[inside][:, None] - b.xy[None], axis=2).min(axis=1)
    assert (away < 1.5).mean() > 0.75, name
    assert np.isfinite(a.xy).all()
    assert (a.xy >= -0.5).all()


@pytest.mark.parametrize("name", available_detectors())
def test_results_do_not_depend_on_threads(name: str, image: Bytes) -> None:
    extractor = make_extractor(config(detector=name, count=COUNT))
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(extractor.extract, [image] * 3))
    for other in found[1:]:
        for field in ("xy", "octave", "angle", "response", "descriptor"):
            np.testing.assert_array_equal(getattr(other, field), getattr(found[0], field))


@pytest.mark.parametrize("name", available_descriptors())
def test_descriptors_of_the_same_place_are_alike(name: str, image: Bytes) -> None:
    detector = (DESCRIPTORS[name].detectors or ("sift",))[0]
    extractor = make_extractor(config(detector=detector, descriptor=name, count=COUNT))
    a, b = extractor.extract(image[:, :-SHIFT_PX]), extractor.extract(image[:, SHIFT_PX:])
    away = np.linalg.norm((a.xy - [SHIFT_PX, 0])[:, None] - b.xy[None], axis=2)
    first, second = np.nonzero(away < 0.1)
    assert len(first) > 50
    x, y = a.descriptor[first].astype(np.float64), b.descriptor[second].astype(np.float64)
    other = b.descriptor[np.roll(second, 7)].astype(np.float64)
    if a.descriptor.dtype == np.uint8:
        bits = [np.unpackbits(d.astype(np.uint8), axis=1) for d in (x, y, other)]
        near, far = (np.mean(bits[0] != b, axis=1) for b in bits[1:])
    else:
        near, far = (np.linalg.norm(x - d, axis=1) for d in (y, other))
    assert np.median(near) < 0.35 * np.median(far)


@pytest.mark.parametrize("name", ["orb", *available_detectors()])
def test_masks_and_empty_images(name: str, image: Bytes) -> None:
    extractor = make_extractor(config(detector=name, count=COUNT))
    mask = np.zeros_like(image)
    mask[:, : image.shape[1] // 2] = 255
    found = extractor.extract(image, mask)
    assert len(found) > 0
    assert found.xy[:, 0].max() < image.shape[1] // 2 + 1
    for nothing in (np.zeros_like(image), np.full((1, 1), 9, np.uint8), np.zeros((8, 9), np.uint8)):
        empty = extractor.extract(nothing)
        assert len(empty) == 0
        extractor.descriptor_format.check(empty.descriptor)
    assert len(extractor.extract(image, np.zeros_like(image))) == 0


def spread(keypoints: Keypoints, image: Bytes) -> float:
    """Ratio of the cells of a 16 x 10 grid that hold a feature."""
    cells = (keypoints.xy * [16, 10] / image.shape[::-1]).astype(int)
    return len({(u, v) for u, v in cells.tolist()}) / 160


def test_selections_spread_features_over_the_image(image: Bytes) -> None:
    ratios = {}
    for selection in ("strongest", "grid", "ssc"):
        extractor = make_extractor(config(detector="fast", count=200, selection=selection))
        found = extractor.extract(image)
        assert 150 < len(found) <= 200
        ratios[selection] = spread(found, image)
    assert ratios["grid"] > 1.2 * ratios["strongest"]
    assert ratios["ssc"] > 1.2 * ratios["strongest"]


def test_square_covering_keeps_the_strongest_apart(image: Bytes) -> None:
    found = make_extractor(config(detector="fast", count=100, selection="ssc", levels=1)).extract(
        image
    )
    away = np.linalg.norm(found.xy[:, None] - found.xy[None], axis=2) + 1e9 * np.eye(len(found))
    assert away.min() > 8.0
    strongest = make_extractor(config(detector="fast", count=100, levels=1, selection="strongest"))
    assert found.response.max() == strongest.extract(image).response.max()


def test_a_pyramid_finds_corners_in_a_smaller_image(image: Bytes) -> None:
    smaller = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    counts = []
    for levels in (1, 4):
        extractor = make_extractor(config(detector="shi_tomasi", levels=levels, count=400))
        a, b = extractor.extract(image), extractor.extract(smaller)
        expected = (a.xy + 0.5) / 2 - 0.5
        away = np.linalg.norm(expected[:, None] - b.xy[None], axis=2)
        counts.append(int(np.count_nonzero(away.min(axis=0) < 1.0)))
    assert counts[1] > 1.1 * counts[0]


def test_refinement_and_equalisation(image: Bytes) -> None:
    square = np.full((100, 100), 60, np.uint8)
    square[50:, 50:] = square[:50, :50] = 180
    blurred = cv2.GaussianBlur(square, (0, 0), 1.0)
    options = {"detector": "harris", "levels": 1, "count": 50, "descriptor": "rootsift"}
    found = make_extractor(config(**options, subpixel=True)).extract(blurred)
    assert np.abs(found.xy - 49.5).max(axis=1).min() < 0.02
    dark = (image // 8).astype(np.uint8)
    plain, equalised = (
        len(make_extractor(config(detector="fast", count=2000, clahe=flag)).extract(dark))
        for flag in (False, True)
    )
    assert equalised > 5 * max(plain, 1)


def test_root_sift_is_the_hellinger_kernel() -> None:
    noise = np.random.default_rng(0)
    a, b = noise.random((2, 1, 128), dtype=np.float32)
    p, q = a[0] / a[0].sum(), b[0] / b[0].sum()
    kernel = float((root_sift(a) @ root_sift(b).T)[0, 0])
    assert kernel == pytest.approx(float(np.sqrt(p * q).sum()), rel=1e-5)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"detector": "orb", "descriptor": "sift"}, "'orb' has its own descriptor, not 'sift'"),
        ({"detector": "sift", "descriptor": "opencv_orb"}, "needs detector 'opencv_orb', not"),
        ({"detector": "nope"}, "nope"),
    ],
)
def test_pairs_that_do_not_go_together_are_refused(values: dict[str, str], message: str) -> None:
    with pytest.raises(vo.ConfigError) as error:
        make_extractor(config(**values))
    assert message in str(error.value)


@pytest.mark.parametrize("name", ["akaze", "surf", "agast"])
def test_what_this_installation_lacks_is_named_with_its_package(name: str) -> None:
    if has_algorithm(DETECTORS[name].algorithm):
        pytest.skip("this build has it")
    with pytest.raises(vo.ConfigError) as error:
        make_extractor(config(detector=name))
    wanted = "OPENCV_ENABLE_NONFREE" if name == "surf" else "opencv-contrib-python-headless"
    assert f"detector '{name}'" in str(error.value)
    assert wanted in str(error.value)
