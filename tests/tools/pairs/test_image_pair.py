"""Matching of two images: model, motion, record and picture."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from two_images import CAMERA, MOTION, layered_pair, plane_homography, plane_pair, texture

from vo.base.config import Config
from vo.base.errors import CalibrationError, ConfigError, OutputError
from vo.base.geometry.transforms import rotation_angle
from vo.base.types import Bytes, Camera, Rig
from vo.tools.pairs.image_pair import ImagePair, PairOptions, match_images, pair_record
from vo.tools.pairs.pair_options import PairChoices, check_cameras, pair_cameras, pair_options
from vo.tools.pairs.pair_picture import fundamental_of, write_pair_picture
from vo.tools.pairs.sampson import line_errors
from vo.tools.pairs.two_view_records import FitFailureReason, ModelKind

BOTH = (CAMERA, CAMERA)


def options(cameras: tuple[Camera, Camera] | None = None, **choices: object) -> PairOptions:
    return pair_options(Config(), PairChoices(**choices), cameras)  # type: ignore[typeddict-item]


@pytest.mark.parametrize("detector", ["orb", "sift", "fast", "shi_tomasi"])
def test_a_plane_gives_its_homography(detector: str) -> None:
    pair = match_images(plane_pair(), options(detector=detector))
    assert pair.fit is not None, pair.failure
    assert pair.fit.kind is ModelKind.HOMOGRAPHY
    assert len(pair.inlier) > 100 and pair.inlier.mean() > 0.8
    found = pair.fit.matrix / pair.fit.matrix[2, 2]
    corners = np.array([[[0, 0], [319, 0], [0, 239], [319, 239]]], dtype=np.float64)
    truth = plane_homography(4.0)
    moved = [cv2.perspectiveTransform(corners, matrix)[0] for matrix in (found, truth)]
    assert np.abs(moved[0] - moved[1]).max() < 1.0
    assert pair.pose is None and pair.pose_failure is None
    assert pair.matcher == "brute_force"
    assert set(pair.stage_ms) == {"features", "matching", "geometry"}


@pytest.mark.parametrize("matcher", ["brute_force", "flann", "ann"])
@pytest.mark.parametrize("detector", ["orb", "sift"])
def test_a_scene_with_depth_gives_the_motion(detector: str, matcher: str) -> None:
    pair = match_images(layered_pair(), options(BOTH, detector=detector, matcher=matcher))
    assert pair.fit is not None and pair.pose is not None
    assert pair.fit.kind is ModelKind.ESSENTIAL
    motion = pair.pose.second_from_first
    error_deg = np.rad2deg(rotation_angle(motion[:3, :3].T @ MOTION[:3, :3]))
    assert error_deg < 0.5
    direction = MOTION[:3, 3] / np.linalg.norm(MOTION[:3, 3])
    assert float(motion[:3, 3] @ direction) > np.cos(np.deg2rad(5.0))
    assert pair.pose.in_front > 0.9 * pair.inlier.sum()
    assert pair.matcher == matcher


def test_the_model_can_be_chosen() -> None:
    images = layered_pair()
    for name, kind in (("f", "fundamental"), ("e", "essential"), ("h", "homography")):
        pair = match_images(images, options(BOTH, model=name))
        assert pair.fit is not None and pair.fit.kind.value == kind
    with pytest.raises(ConfigError, match="calibration"):
        options(model="e")


def test_images_of_two_lenses_and_sizes() -> None:
    """The second image enlarged, and seen through a lens of another focal length."""
    first, second = layered_pair()
    larger = cv2.resize(second, (640, 480), interpolation=cv2.INTER_CUBIC)
    other = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
    pair = match_images((first, np.asarray(larger)), options((CAMERA, other), detector="sift"))
    assert pair.sizes == ((320, 240), (640, 480))
    assert pair.pose is not None
    turned = pair.pose.second_from_first[:3, :3].T @ MOTION[:3, :3]
    assert np.rad2deg(rotation_angle(turned)) < 0.5


@pytest.mark.parametrize("model", ["auto", "h", "f", "e"])
@pytest.mark.parametrize("detector", ["orb", "sift"])
def test_unrelated_images_share_no_geometry(detector: str, model: str) -> None:
    images = [texture(seed, 240, 320) for seed in range(3, 9)]
    chosen = options(BOTH, detector=detector, model=model, ratio=0.95)
    for one, other in zip(images, images[1:], strict=False):
        pair = match_images((one, other), chosen)
        assert len(pair.matches.query) > 3
        assert pair.fit is None and pair.failure is not None
        record = pair_record(pair, chosen, ("a", "b"))
        assert (
            record["inliers"] == 0 and record["failure_reason"] == pair.failure.reason.name.lower()
        )


def blank(grey: int = 0, size: tuple[int, int] = (240, 320)) -> Bytes:
    return np.full(size, grey, np.uint8)


@pytest.mark.parametrize("detector", ["orb", "sift", "fast", "harris", "mser", "opencv_orb"])
@pytest.mark.parametrize("other", [blank(), blank(255), blank(9, (1, 1)), blank(9, (1, 500))])
def test_images_without_features_give_a_named_failure(detector: str, other: Bytes) -> None:
    for images in ((layered_pair()[0], other), (other, other)):
        pair = match_images(images, options(detector=detector))
        assert pair.fit is None and pair.pose is None
        assert pair.failure is not None
        assert pair.failure.reason is FitFailureReason.FEW_MATCHES


def test_the_same_image_twice_does_not_move() -> None:
    image = layered_pair()[0]
    pair = match_images((image, image), options(BOTH))
    assert pair.fit is not None and pair.pose is not None
    assert pair.fit.kind is ModelKind.HOMOGRAPHY
    assert not pair.pose.has_translation
    np.testing.assert_array_equal(pair.pose.second_from_first, np.eye(4))


def test_masks_leave_parts_out() -> None:
    mask = np.zeros((240, 320), np.uint8)
    mask[:, :160] = 255
    pair = match_images(layered_pair(), options(), (mask, None))
    assert pair.keypoints[0].xy[:, 0].max() < 160 < pair.keypoints[1].xy[:, 0].max()


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"model": "x"}, "no model 'x'"),
        ({"method": "magsak"}, "did you mean 'magsac'"),
        ({"ratio": 2.0}, "matching.ratio"),
        ({"threshold_px": 0.0}, "threshold is 0.0 px"),
        ({"threshold_px": float("nan")}, "threshold is nan px"),
        ({"detector": "sitf"}, "features.detector"),
        ({"matcher": "best"}, "matching.method"),
    ],
)
def test_unknown_choices_are_refused(choices: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        options(**choices)


def test_cameras_must_be_of_the_size_of_the_images() -> None:
    images = layered_pair()
    check_cameras(BOTH, images, ("a", "b"))
    wrong = replace(CAMERA, width=640, height=480)
    with pytest.raises(CalibrationError, match="b has 320x240 pixels, .* 640x480"):
        check_cameras((CAMERA, wrong), images, ("a", "b"))
    with pytest.raises(CalibrationError, match="no cam1"):
        pair_cameras(Rig(CAMERA), (None, None), right=True)
    with pytest.raises(CalibrationError, match="give its calibration"):
        pair_cameras(None, (None, None), right=True)
    assert pair_cameras(Rig(CAMERA), (None, None), right=False) == BOTH
    assert pair_cameras(None, (CAMERA, None), right=False) is None


def found() -> ImagePair:
    return match_images(layered_pair(), options(BOTH))


def test_the_record_is_json() -> None:
    chosen = options(BOTH, detector="orb")
    record = json.loads(json.dumps(pair_record(found(), chosen, ("a", "b")), allow_nan=False))
    assert record["images"][0]["name"] == "a" and record["images"][1]["width"] == 320
    assert record["model"]["kind"] == "essential"
    assert record["failure"] is None and record["failure_reason"] is None
    assert record["chance"]["inliers"] >= record["chance"]["needed"]
    assert 0 < record["inliers"] <= record["matches"]
    assert record["pose"]["has_translation"]
    assert np.shape(record["pose"]["second_from_first"]) == (4, 4)
    none = match_images((blank(), blank()), chosen)
    record = json.loads(json.dumps(pair_record(none, chosen, ("a", "b")), allow_nan=False))
    assert record["model"] is None and record["failure"] == "0 matches, 6 needed"


def test_the_picture_shows_both_images_and_their_matches(tmp_path: Path) -> None:
    images, pair = layered_pair(), found()
    for name, epipolar in (("plain.png", False), ("lines.jpg", True)):
        write_pair_picture(tmp_path / name, images, pair, epipolar=epipolar)
        drawn = cv2.imread(str(tmp_path / name))
        assert drawn is not None and drawn.shape == (240, 648, 3)
    plain = cv2.imread(str(tmp_path / "plain.png"))
    assert plain is not None
    assert (plain == (233, 180, 86)).all(axis=2).sum() > 1000  # inliers in blue
    with pytest.raises(OutputError, match=r"\.png"):
        write_pair_picture(tmp_path / "x.tiff", images, pair)
    with pytest.raises(OutputError, match="cannot be written"):
        write_pair_picture(tmp_path / "plain.png" / "x.png", images, pair)


def test_a_picture_of_nothing_and_of_large_images(tmp_path: Path) -> None:
    small = blank(0, (1, 1))
    write_pair_picture(
        tmp_path / "small.png", (small, small), match_images((small, small), options())
    )
    large = blank(0, (300, 5000))
    write_pair_picture(
        tmp_path / "large.png", (large, small), match_images((large, small), options())
    )
    drawn = cv2.imread(str(tmp_path / "large.png"))
    assert drawn is not None and drawn.shape[1] <= 2400


def test_epipolar_lines_are_those_of_the_model() -> None:
    for name in ("f", "e"):
        pair = match_images(layered_pair(), options(BOTH, model=name))
        fundamental = fundamental_of(pair)
        assert fundamental is not None
        errors = line_errors(fundamental, pair.first_xy, pair.second_xy)
        assert np.median(errors[pair.inlier]) < 0.5
    image = layered_pair()[0]
    assert fundamental_of(match_images((image, image), options(BOTH))) is None
