"""`vo.match` and `vo.features.create`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from two_images import CAMERA, MOTION, layered_pair

import vo
from vo.base.geometry.transforms import rotation_angle

A, B = layered_pair()
RIG = vo.Rig(CAMERA)


def test_two_arrays() -> None:
    found = vo.match(A, B, calibration=RIG)
    assert found.fit is not None and found.pose is not None
    turned = found.pose.second_from_first[:3, :3].T @ MOTION[:3, :3]
    assert np.rad2deg(rotation_angle(turned)) < 0.5
    assert len(found.first_xy) == len(found.second_xy) == len(found.inlier) > 100


def test_colour_16_bits_and_files_give_the_same(tmp_path: Path) -> None:
    grey = vo.match(A, B)
    colour = vo.match(np.dstack([A] * 3), np.dstack([B] * 4), colour="rgb")
    for path, image in ((tmp_path / "a.png", A), (tmp_path / "b.png", B)):
        cv2.imwrite(str(path), image)
    files = vo.match(tmp_path / "a.png", str(tmp_path / "b.png"))
    for other in (colour, files):
        np.testing.assert_array_equal(grey.matches.query, other.matches.query)
        assert grey.fit is not None and other.fit is not None
        np.testing.assert_array_equal(grey.fit.matrix, other.fit.matrix)
    deep = vo.match(A.astype(np.uint16) * 200, B.astype(np.uint16) * 200)
    assert deep.inlier.sum() > 0.8 * grey.inlier.sum()


def test_options_and_settings() -> None:
    found = vo.match(A, B, overrides=["features.count=200"], detector="sift", method="prosac")
    assert found.keypoints[0].descriptor.shape[1] == 128
    assert len(found.keypoints[0]) <= 200
    assert found.fit is not None and found.fit.method == "prosac"
    half = np.zeros(A.shape, bool)
    half[:, :160] = True
    masked = vo.match(A, B, masks=(half, None))
    assert masked.keypoints[0].xy[:, 0].max() < 160


@pytest.mark.parametrize(
    ("a", "options", "error", "message"),
    [
        (None, {}, vo.InputError, "a is None"),
        (3, {}, vo.InputError, "a is of type int"),
        (A.astype(float), {}, vo.InputError, "float64"),
        (A[0], {}, vo.InputError, "shape"),
        (np.empty((0, 0), np.uint8), {}, vo.InputError, "without pixels"),
        (np.empty((0, 5, 3), np.uint8), {}, vo.InputError, "without pixels"),
        ("nothing.png", {}, vo.SourceError, "does not exist"),
        (".", {}, vo.SourceError, "is no image"),
        ("nothing:3", {}, vo.SourceError, "nothing does not exist"),
        (A, {"masks": (A[:9], None)}, vo.InputError, "320x9 pixels, its image 320x240"),
        (A, {"masks": (A.astype(float), None)}, vo.InputError, "mask of a is float64"),
        (A, {"masks": A}, vo.ConfigError, "give one for each image"),
        (A, {"overrides": ["masks.ignore=[9]"]}, vo.ConfigError, "masks.ignore"),
        (A, {"colour": "hsv"}, vo.ConfigError, "'hsv'"),
        (A, {"colour": None}, vo.ConfigError, "None"),
        (A, {"model": "e"}, vo.ConfigError, "calibration"),
        (A, {"calibration": 3}, vo.ConfigError, "calibration is of type int"),
        (A, {"calibration": RIG, "right": True}, vo.CalibrationError, "no cam1"),
        (A[:99], {"calibration": RIG}, vo.CalibrationError, "320x99 pixels"),
        (A, {"mask": 1}, vo.ConfigError, "no option 'mask'"),
        (A, {"detector": 7}, vo.ConfigError, "features.detector"),
        (A, {"threshold_px": "1"}, vo.ConfigError, "threshold"),
        (A, {"method": ["magsac"]}, vo.ConfigError, "method"),
    ],
)
def test_wrong_arguments(
    a: Any, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message) as caught:
        vo.match(a, B, **options)
    assert "\n" not in str(caught.value)


def test_features_by_name() -> None:
    sift = vo.features.create("sift", count=300)
    found = sift.detect(A)
    assert 100 < len(found) <= 300
    assert found.descriptor.shape == (len(found), sift.descriptor_format.width)
    mask = np.zeros(A.shape, np.uint8)
    mask[100:] = 1
    assert sift.detect(np.dstack([A] * 3), mask).xy[:, 1].min() > 99
    assert len(vo.features.create("orb").detect(np.zeros((1, 1), np.uint8))) == 0
    assert vo.features.create("fast", descriptor="rootsift").descriptor_format.width == 128


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("sitf", {}, "did you mean 'sift'"),
        (None, {}, "no detector None"),
        ("sift", {"counts": 3}, "did you mean 'count'"),
        ("sift", {"count": 3}, "setting 'count'"),
        ("orb", {"descriptor": "sift"}, "its own descriptor"),
    ],
)
def test_unknown_features(name: Any, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(vo.ConfigError, match=message):
        vo.features.create(name, **settings)


def test_wrong_images_and_masks() -> None:
    orb = vo.features.create("orb")
    with pytest.raises(vo.InputError, match="image is None"):
        orb.detect(None)
    with pytest.raises(vo.InputError, match="mask has"):
        orb.detect(A, A[:, :100])


def test_features_are_an_extractor_of_the_odometry() -> None:
    components = vo.Components(extractor=vo.features.create("orb"))
    odometry = vo.Odometry(RIG, components=components)
    estimate = odometry.track(0, A)
    assert estimate.features > 100
