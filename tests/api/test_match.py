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
        (A, {"msak": 1}, vo.ConfigError, "no option 'msak'"),
        (A, {"best": 3}, vo.ConfigError, "`best` needs `picture=FILE`"),
        (A, {"warp": "w.png", "model": "f"}, vo.ConfigError, "`warp` needs a homography"),
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


def test_pictures_are_those_of_the_command(tmp_path: Path) -> None:
    seen = vo.match(A, B, picture=tmp_path / "p.png", best=20, epipolar=True, ignore="0,0,160,240")
    assert seen.keypoints[0].xy[:, 0].min() > 159
    picture = cv2.imread(str(tmp_path / "p.png"))
    assert picture is not None and picture.shape[1] >= 2 * A.shape[1]
    warped = vo.match(A, B, warp=tmp_path / "w.png")
    assert warped.fit is not None and warped.fit.kind.value == "homography"
    assert cv2.imread(str(tmp_path / "w.png")) is not None


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    for name, image in (("a.png", A), ("b.png", B), ("c.png", A[:, ::-1])):
        cv2.imwrite(str(tmp_path / "photos" / name), image)
    return tmp_path / "photos"


def test_pairs_of_a_folder_are_those_of_two_images(folder: Path, tmp_path: Path) -> None:
    every = vo.match_folder(folder, output=[tmp_path / "m.npz", tmp_path / "m.db"])
    assert [(each.image_a, each.image_b) for each in every] == [
        ("a.png", "b.png"),
        ("a.png", "c.png"),
        ("b.png", "c.png"),
    ]
    alone = vo.match(A, B)
    assert (every[0].matches, every[0].inliers) == (len(alone.inlier), alone.inlier.sum())
    assert len(np.load(tmp_path / "m.npz")["matches/a.png/b.png"]) == every[0].matches
    (tmp_path / "pairs.txt").write_text("a.png b.png\n")
    for pairs in ([("a.png", "b.png")], tmp_path / "pairs.txt", str(tmp_path / "pairs.txt")):
        assert vo.match_folder(folder, pairs=pairs) == every[:1]  # type: ignore[arg-type]
    few = vo.match_folder(folder, window=1, calibration=CAMERA, model="e", detector="sift")
    assert len(few) == 2 and few[0].model == "essential"
    assert len(vo.match_folder(str(folder), roi="0,0,160,240", pairs=[("a.png", "c.png")])) == 1


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"pairs": [("a.png",)]}, vo.ConfigError, "give names of two images"),
        ({"pairs": []}, vo.ConfigError, "`pairs` is empty"),
        ({"pairs": "none.txt"}, vo.SourceError, "list of pairs none.txt"),
        ({"window": 0}, vo.ConfigError, "`window` is 0"),
        ({"output": "m.txt"}, vo.OutputError, "must end in"),
        ({"right": True}, vo.ConfigError, "vo.match_folder has no option 'right'"),
    ],
)
def test_folders_refuse_what_cannot_be_meant(
    options: dict[str, Any], error: type[Exception], message: str, folder: Path
) -> None:
    with pytest.raises(error, match=message):
        vo.match_folder(folder, **options)


def test_methods_are_compared_by_truth_and_by_planes(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    rows = vo.features.compare(
        synthetic_stereo, ["orb", "klt"], gaps=[1, 3], pairs=2, picture=tmp_path / "c.png"
    )
    assert [(row.method, row.gap, row.pairs) for row in rows] == [
        ("orb", 1, 2),
        ("orb", 3, 2),
        ("klt", 1, 2),
        ("klt", 3, 2),
    ]
    assert rows[0].precision > 0.8 and (tmp_path / "c.png").stat().st_size > 0
    for name in ("1.png", "2.png"):
        cv2.imwrite(str(tmp_path / name), A)
    (tmp_path / "H_1_2").write_text("1 0 0 0 1 0 0 0 1")
    planes = vo.features.compare_planes(tmp_path, "orb")
    assert [row.within_1_px for row in planes] == [1.0]
    images = {"second": tmp_path / "2.png", "homography": tmp_path / "H_1_2"}
    again = vo.features.compare_planes(tmp_path / "1.png", ["orb"], **images)
    assert again[0].matches == planes[0].matches
    with pytest.raises(vo.SourceError, match="no images of a plane"):
        vo.features.compare_planes(tmp_path / "none", "orb")
    with pytest.raises(vo.ConfigError, match="`gaps` is"):
        vo.features.compare(synthetic_stereo, "orb", gaps=[0])
    with pytest.raises(vo.ConfigError, match="`methods` is empty"):
        vo.features.compare(synthetic_stereo, [])


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


def test_wide_fisheyes_have_a_motion(tmp_path: Path) -> None:
    """Images of 160 degrees, whose ideal pixels at the edge are far away."""
    settings = ["world=room", "motion=handheld", "seconds=1", "fps=4", "seed=3"]
    path = vo.synth(tmp_path / "walk", camera="robot", effects="none", overrides=settings)
    recording = vo.open(path)
    found = vo.match(f"{path}:0", f"{path}:1")
    assert found.pose is not None
    truth = recording.ground_truth
    assert truth is not None
    first, second = (
        truth.world_from_cam[np.argmin(np.abs(truth.stamps_ns - stamp))]
        for stamp in recording.stamps_ns[:2]
    )
    moved = np.linalg.inv(second) @ first
    turn = found.pose.second_from_first[:3, :3].T @ moved[:3, :3]
    assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))) < 1.0
