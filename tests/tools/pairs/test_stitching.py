"""Two images in one picture, panoramas, and what the calibration of a pair of cameras adds."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from two_images import CAMERA, MOTION, layered_pair, plane_homography, plane_pair, texture
from typer.testing import CliRunner, Result

import vo
from vo.base.config import load_config
from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Camera, Rig
from vo.cli.app import app
from vo.tools.pairs.image_pair import PairOptions
from vo.tools.pairs.turned_views import find_turns

DETECTOR = "features.detector=sift"


def run(*words: object) -> Result:
    return CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)


def test_homographies_have_the_usual_scale() -> None:
    found = vo.match(*plane_pair(), model="h")
    assert found.fit is not None
    truth = plane_homography(4.0)
    assert found.fit.matrix[2, 2] == 1.0
    assert np.abs(found.fit.matrix - truth / truth[2, 2]).max() < 0.5


def test_warped_picture_shows_the_plane_once(tmp_path: Path) -> None:
    first, second = plane_pair()
    for name, image in (("a.png", first), ("b.png", second)):
        cv2.imwrite(str(tmp_path / name), image)
    out = tmp_path / "warped.png"
    assert run("match", tmp_path / "a.png", tmp_path / "b.png", "--warp", out).exit_code == 0
    picture = cv2.imread(str(out), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    found = cv2.matchTemplate(picture, second[60:180, 80:240], cv2.TM_CCOEFF_NORMED)
    assert found.max() > 0.98
    assert picture.shape[1] > 320


def turned_views(count: int) -> list[np.ndarray]:
    """Views of one wide plane by a camera that turns by 12 degrees each."""
    wide = texture(5, 900, 1600)
    matrix = CAMERA.matrix
    views = []
    for number in range(count):
        turn = se3_exp(np.array([0.0, np.deg2rad(12.0) * (number - 1), 0.0, 0, 0, 0]))[:3, :3]
        shift = np.array([[1, 0, 640], [0, 1, 330], [0, 0, 1]], dtype=np.float64)
        homography = shift @ matrix @ turn @ np.linalg.inv(matrix)
        views.append(cv2.warpPerspective(wide, homography, (320, 240), flags=cv2.WARP_INVERSE_MAP))
    return views


def test_panorama_is_wider_than_its_images(tmp_path: Path) -> None:
    names = [tmp_path / f"{number}.png" for number in range(3)]
    for name, view in zip(names, turned_views(3), strict=True):
        cv2.imwrite(str(name), view)
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), texture(99, 240, 320))
    out = tmp_path / "out.jpg"
    result = run("panorama", *names, other, "-o", out, "--json")
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record["width"] > 400 and 200 < record["height"] < 300
    assert "other.png" in result.stderr and "left out" in result.stderr
    assert "camera moved" not in result.stderr


def test_views_of_a_calibrated_camera_are_placed_by_their_rotations(tmp_path: Path) -> None:
    """Views that overlap by nine tenths hardly show the focal length, which is known."""
    wide, options = texture(5, 900, 1600), PairOptions(load_config("default", [DETECTOR]))
    matrix, shift = CAMERA.matrix, np.array([[1, 0, 640], [0, 1, 330], [0, 0, 1]], np.float64)
    views = []
    for number in range(3):
        turn = se3_exp(np.array([0.0, np.deg2rad(3.0) * (number - 1), 0.0, 0, 0, 0]))[:3, :3]
        homography = shift @ matrix @ turn @ np.linalg.inv(matrix)
        grey = cv2.warpPerspective(wide, homography, (320, 240), flags=cv2.WARP_INVERSE_MAP)
        views.append(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    found = find_turns(views, CAMERA, options)
    assert sorted(found.rotations) == [0, 1, 2] and not found.camera_moved
    for a, b in ((0, 1), (1, 2)):
        turn = found.rotations[a].T @ found.rotations[b]
        assert np.rad2deg(np.linalg.norm(cv2.Rodrigues(turn)[0])) == pytest.approx(3.0, abs=0.1)
    picture = vo.panorama(views, calibration=CAMERA)
    half = np.arctan(160.0 / CAMERA.fx) + np.deg2rad(3.0)
    assert picture.shape[1] == pytest.approx(2.0 * half * CAMERA.fx, abs=4)
    assert (picture[40:-40, 10:-10].max(axis=2) == 0).mean() < 0.002  # no gap


def test_panorama_of_unrelated_images_is_refused(tmp_path: Path) -> None:
    for seed in (1, 2):
        cv2.imwrite(str(tmp_path / f"{seed}.png"), texture(seed, 240, 320))
    result = run("panorama", tmp_path, "-o", tmp_path.parent / "none.png")
    assert result.exit_code == 1 and "error: no panorama:" in result.stderr
    assert not (tmp_path.parent / "none.png").exists()


def test_a_moved_camera_is_named(tmp_path: Path) -> None:
    motion = se3_exp(np.array([0.0, 0.0, 0.0, 0.6, 0.0, 0.0]))
    for name, image in zip("ab", layered_pair(motion), strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    result = run("panorama", tmp_path, "-o", tmp_path.parent / "moved.png")
    assert "camera moved" in result.stderr or "no panorama" in result.stderr


def test_calibrated_pairs_give_metres() -> None:
    rig = Rig(CAMERA, CAMERA, MOTION)
    found = vo.match(*layered_pair(), calibration=rig, right=True)
    assert found.pose is not None and found.pose.is_metric
    assert (found.pose.second_from_first == MOTION).all()
    assert found.pose.depth_m is not None and 2.0 <= found.pose.depth_m <= 6.0
    assert not found.baseline_contradicted


def test_calibrated_pairs_that_matches_contradict_are_named() -> None:
    wrong = MOTION.copy()
    wrong[:3, 3] = [0.0, 0.3, 0.0]
    found = vo.match(*layered_pair(), calibration=Rig(CAMERA, CAMERA, wrong), right=True)
    assert found.baseline_contradicted
    assert found.pose is not None and not found.pose.is_metric


@pytest.mark.parametrize("given", [CAMERA, CAMERA.matrix, CAMERA.matrix.tolist()])
def test_calibration_may_be_a_camera_or_a_matrix(given: Camera) -> None:
    found = vo.match(*layered_pair(), calibration=given)
    assert found.pose is not None
    direction = MOTION[:3, 3] / np.linalg.norm(MOTION[:3, 3])
    assert found.pose.second_from_first[:3, 3] @ direction > 0.99


@pytest.mark.parametrize("given", [np.eye(4), np.zeros((3, 3)), [[1, 2], [3]]])
def test_other_matrices_are_refused(given: object) -> None:
    with pytest.raises(CalibrationError, match="no camera matrix"):
        vo.match(*layered_pair(), calibration=given)  # type: ignore[arg-type]


def test_regions_of_one_image_leave_the_other_whole() -> None:
    whole = vo.match(*layered_pair(), detector="sift")
    part = vo.match(*layered_pair(), detector="sift", roi_a=["0,0,160,240"])
    assert len(part.keypoints[1]) == len(whole.keypoints[1])
    assert part.keypoints[0].xy[:, 0].max() < 161
