"""Scores of methods on pairs whose true motion or homography is known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import vo
from vo.base.config import load_config
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Bytes, Camera, Floats, Rig
from vo.recordings.formats.trajectory import read_tum
from vo.tools.laboratory.comparison import (
    ImagePair,
    PairScore,
    choose_pairs,
    compare,
    score_pair,
    summarise,
    true_motion,
)
from vo.tools.laboratory.methods import Method, make_method
from vo.tools.laboratory.repeatability import (
    by_depth,
    by_homography,
    repeatability,
    score_plane,
    transferred,
)

CONFIG = load_config("default", ["features.count=500"])
CAMERA = Camera(320, 240, 300.0, 300.0, 160.0, 120.0)


def method(name: str) -> Method:
    return make_method(name, CONFIG.features, CONFIG.matching)


@pytest.fixture(scope="module")
def frames(synthetic_stereo: Path) -> list[vo.Frame]:
    return list(vo.open(synthetic_stereo, mode="mono").frames())


@pytest.fixture(scope="module")
def image(frames: list[vo.Frame]) -> Bytes:
    return frames[0].image0


@pytest.mark.parametrize("name", ["orb", "sift", "klt"])
def test_the_motion_of_a_pair_is_found(
    name: str, synthetic_stereo: Path, frames: list[vo.Frame]
) -> None:
    camera = vo.open(synthetic_stereo, mode="mono").rig.cam0
    poses = read_tum(synthetic_stereo / "groundtruth.tum").world_from_cam
    pairs = [
        ImagePair(8, frames[i].image0, frames[i + 8].image0, true_motion(poses[i], poses[i + 8]))
        for i in (0, 10, 20)
    ]
    (row,) = compare([method(name)], pairs, camera)
    assert (row.method, row.gap, row.pairs) == (name, 8, 3)
    assert row.good_ratio >= 1 / 3
    assert row.rotation_deg < 0.5
    assert row.direction_deg < 4
    assert row.precision > 0.8
    assert 0.1 < row.matching_score <= row.matches / row.features
    assert row.inlier_ratio > 0.7
    assert np.isnan(row.repeatability)
    assert min(row.extract_ms, row.match_ms) > 0


def test_a_pure_rotation_has_no_direction() -> None:
    image = noise()
    turn = make_transform(so3_exp(np.array([0.0, 0.04, 0.01])), np.zeros(3))
    warp = CAMERA.matrix @ turn[:3, :3] @ np.linalg.inv(CAMERA.matrix)
    turned = np.asarray(cv2.warpPerspective(image, warp, (320, 240)), dtype=np.uint8)
    score = score_pair(
        method("sift"), ImagePair(1, image, turned, turn), rectified_rig(Rig(CAMERA))
    )
    assert np.isnan(score.direction_deg)
    assert score.correct > 0.9 * score.matches > 50
    assert score.error_deg == score.rotation_deg < 0.5


def test_a_pair_without_a_motion_counts_as_180_degrees() -> None:
    black = np.zeros((240, 320), np.uint8)
    pair = ImagePair(5, black, black, make_transform(np.eye(3), np.array([1.0, 0.0, 0.0])))
    (row,) = compare([method("orb")], [pair], CAMERA)
    assert (row.matches, row.precision, row.matching_score, row.inlier_ratio) == (0, 0, 0, 0)
    assert (row.good_ratio, row.rotation_deg, row.direction_deg) == (0, 180, 180)


def test_failed_pairs_do_not_vanish_from_the_median() -> None:
    good = PairScore(100, 50, 40, 45, 0.1, 1.0, 5.0, 2.0, 0.5)
    bad = PairScore(100, 0, 0, 0, 180.0, 180.0, 7.0, 0.0)
    row = summarise("x", 3, [good, bad, bad])
    assert row.good_ratio == pytest.approx(1 / 3)
    assert (row.rotation_deg, row.direction_deg) == (180, 180)
    assert (row.matching_score, row.precision) == (pytest.approx(40 / 300), 0.8)
    assert row.extract_ms == pytest.approx(19 / 3)
    assert row.repeatability == 0.5


def test_nothing_to_compare_gives_no_rows_and_keeps_the_threads() -> None:
    threads = cv2.getNumThreads()
    assert compare([method("orb")], [], CAMERA) == []
    assert cv2.getNumThreads() == threads


def test_rows_are_ordered_by_method_and_gap() -> None:
    image, still = noise(), np.eye(4)
    pairs = [ImagePair(gap, image, image, still) for gap in (5, 1, 5)]
    seen: list[str] = []
    rows = compare([method("orb"), method("fast")], pairs, CAMERA, seen.append)
    assert [(r.method, r.gap, r.pairs) for r in rows] == [
        *(("orb", 1, 1), ("orb", 5, 2)),
        *(("fast", 1, 1), ("fast", 5, 2)),
    ]
    assert seen == ["orb", "fast"] * 3
    assert all(row.precision == 1 for row in rows)


def test_a_wide_lens_is_rectified() -> None:
    wide = Camera(320, 240, 90.0, 90.0, 160.0, 120.0, "equidistant", (0.0, 0.0, 0.0, 0.0))
    (row,) = compare([method("orb")], [ImagePair(1, noise(), noise(), np.eye(4))], wide)
    assert row.precision == 1


def test_pairs_lie_in_the_middle_of_equal_parts() -> None:
    usable = np.ones(100, dtype=bool)
    usable[90:] = False
    chosen = {gap: firsts.tolist() for gap, firsts in choose_pairs(usable, [1, 50, 89, 90, 200], 4)}
    assert chosen == {1: [11, 33, 55, 77], 50: [5, 15, 25, 35], 89: [0], 90: [], 200: []}


def test_repeatability_of_the_same_image_is_1(image: Bytes) -> None:
    score = score_plane(method("sift"), image, image, np.eye(3))
    assert (score.repeatability, score.precision) == (1, 1)
    assert score.matching_score > 0.95
    assert score.features[0] == score.features[1]


def test_matches_follow_a_homography(image: Bytes) -> None:
    homography = np.array([[1.05, 0.06, -12.0], [-0.05, 1.03, 9.0], [1e-5, 4e-5, 1.0]])
    size = image.shape[1], image.shape[0]
    moved = np.asarray(cv2.warpPerspective(image, homography, size), dtype=np.uint8)
    for name in ("orb", "sift", "klt"):
        right = score_plane(method(name), image, moved, homography)
        wrong = score_plane(method(name), image, moved, np.linalg.inv(homography))
        assert right.precision > 0.93
        assert right.repeatability > 0.5
        assert right.matching_score > 0.45
        assert wrong.precision < 0.2


def test_repeatability_counts_each_feature_once() -> None:
    first = np.array([[10.0, 10.0], [10.5, 10.0], [50.0, 50.0], [99.0, 5.0]])
    second = np.array([[10.2, 10.0], [53.0, 50.0]])
    transfers = by_homography(np.eye(3), (80, 90), (80, 90))  # the last lies outside
    assert repeatability(first, second, transfers) == 0.5
    assert repeatability(first, np.empty((0, 2)), transfers) == 0
    assert repeatability(np.empty((0, 2)), np.empty((0, 2)), transfers) == 0


def test_depth_takes_pixels_to_the_other_image() -> None:
    rig = rectified_rig(Rig(CAMERA))
    depth = np.full((240, 320), 4.0, np.float32)
    motion = make_transform(np.eye(3), np.array([0.2, 0.0, 0.0]))
    hidden = depth.copy()
    hidden[:, 200:] = 2.0
    there = by_depth((depth, hidden), motion, rig).forward
    moved = there(np.array([[100.0, 50.0], [190.0, 50.0], [315.0, 50.0]]))
    np.testing.assert_allclose(moved[0], [115.0, 50.0])  # 0.2 m at 4 m: 15 px
    assert np.isnan(moved[1:]).all()  # behind something nearer, and outside
    unknown = by_depth((np.zeros_like(depth), depth), motion, rig)
    assert np.isnan(unknown.forward(np.array([[100.0, 50.0]]))).all()


def test_repeatability_by_depth_is_part_of_a_comparison() -> None:
    image = noise()
    shifted = np.roll(image, 15, axis=1)
    depth = np.full((240, 320), 4.0, np.float32)
    motion = make_transform(np.eye(3), np.array([0.2, 0.0, 0.0]))
    pair = ImagePair(1, image, shifted, motion, (depth, depth))
    (row,) = compare([method("sift")], [pair], CAMERA)
    assert row.repeatability > 0.7


def test_points_at_infinity_are_no_matches() -> None:
    homography = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.01, 0.0, 1.0]])
    assert not np.isfinite(transferred(np.array([[100.0, 3.0]]), homography)).all()


def noise() -> Bytes:
    """Smooth noise with features at several scales."""
    source = np.random.default_rng(0)
    total: Floats = np.zeros((240, 320))
    for side in (2, 5, 12):
        coarse = source.normal(size=(240 // side + 2, 320 // side + 2))
        total += cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 40 * total, 0, 255).astype(np.uint8)
