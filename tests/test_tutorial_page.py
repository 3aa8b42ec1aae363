"""The page docs/tutorial.md: its commands and Python lines run as they stand there."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from marker_views import Placed, developed, looking_at, random_background, render
from typer.testing import CliRunner

import vo
from vo.base.types import Bytes, Camera, Floats
from vo.cli.app import app

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorial.md"
SHORT = {"vo synth room --preset demo": "vo synth room --preset demo --motion handheld --seconds 4"}


def test_commands_and_python_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(sh|python)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert len(blocks) > 10
    variables: dict[str, Any] = {}
    for kind, text in blocks:
        if kind == "python":
            exec(text, variables)
            continue
        for line in text.splitlines():
            words = shlex.split(SHORT.get(line, line))
            if words[0] != "vo":
                subprocess.run(line, shell=True, check=True)
                continue
            result = CliRunner().invoke(app, words[1:], catch_exceptions=False)
            assert result.exit_code == 0, f"{line}: {result.output}"
    for name in ("features.png", "matches.jpg", "warped.jpg", "loops.png", "axes.jpg"):
        assert cv2.imread(name) is not None, name


def corner_error(found: Floats | None, truth: Floats, size: tuple[int, int]) -> float:
    """Mean distance of the corners in pixels."""
    if found is None:
        return 1e3
    corners = np.array([[[0, 0], [size[0], 0], [0, size[1]], [size[0], size[1]]]], np.float64)
    moved = [cv2.perspectiveTransform(corners, each)[0] for each in (found, truth)]
    return float(np.linalg.norm(moved[0] - moved[1], axis=1).mean())


def usual_homography(first: Bytes, second: Bytes) -> Floats | None:
    orb = cv2.ORB_create(1500)  # type: ignore[attr-defined]
    (a, of_a), (b, of_b) = (orb.detectAndCompute(each, None) for each in (first, second))
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(of_a, of_b, k=2)
    good = [one for one, other in pairs if one.distance < 0.75 * other.distance]
    p = np.array([a[m.queryIdx].pt for m in good])
    q = np.array([b[m.trainIdx].pt for m in good])
    return np.asarray(cv2.findHomography(p, q, cv2.RANSAC, 5.0)[0])


def test_homographies_are_more_exact_than_the_usual_ones(synthetic_stereo: Path) -> None:
    image = next(iter(vo.open(synthetic_stereo).frames(0, 1))).image0
    height, width = image.shape
    ours, usual = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        square = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
        moved = (square + rng.uniform(-0.1, 0.1, (4, 2)) * width).astype(np.float32)
        truth = cv2.getPerspectiveTransform(square, moved)
        seen = cv2.warpPerspective(image, truth, (width, height)) + rng.normal(0, 4, image.shape)
        second = np.clip(seen, 0, 255).astype(np.uint8)
        fit = vo.match(image, second, model="h", detector="sift").fit
        ours.append(corner_error(None if fit is None else fit.matrix, truth, (width, height)))
        usual.append(corner_error(usual_homography(image, second), truth, (width, height)))
    assert np.median(ours) < 0.5 * np.median(usual)


def test_markers_are_more_exact_than_the_usual_ones() -> None:
    camera = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(family, cv2.aruco.DetectorParameters())
    half = 0.08
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    ours, usual = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        place = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.7, 2.0)])
        pose = looking_at(place, rng.uniform(0.2, 0.8), rng.uniform(0, 6), 0.0)
        background = random_background(rng, (480, 640))
        image = developed(render(camera, Placed("APRILTAG_36H11", 7, 0.16, pose), background), rng)
        (found,) = vo.find_markers(image, 0.16, calibration=camera, dictionary="tag36h11")
        assert found.pose is not None
        ours.append(np.linalg.norm(found.pose.cam_from_marker[:3, 3] - place))
        corners = detector.detectMarkers(image)[0][0].reshape(4, 2).astype(np.float64)
        flag = cv2.SOLVEPNP_IPPE_SQUARE
        position = cv2.solvePnP(square, corners, camera.matrix, None, flags=flag)[2]
        usual.append(np.linalg.norm(position.ravel() - place))
    assert np.median(ours) < 0.1 * np.median(usual)
