"""Calibration of unknown cameras, then visual odometry with them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from board_images import poses_around, render
from typer.testing import CliRunner

from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Camera, Rig
from vo.cli.app import app
from vo.recordings.formats.calibration import write_calibration
from vo.tools.calibrating.board import make_board

SIZE = (400, 250)
LEFT = Camera(*SIZE, 223.0, 221.0, 204.0, 121.0, "radtan", (-0.25, 0.06, 3e-4, -2e-4))
RIGHT = Camera(*SIZE, 226.0, 224.0, 196.0, 127.0, "radtan", (-0.24, 0.05, -2e-4, 1e-4))
TURN = so3_exp(np.array([0.01, -0.02, 0.015]))
RIG = Rig(LEFT, RIGHT, make_transform(TURN, np.array([-0.12, 0.002, 0.001])))
BOARD = make_board("charuco", 7, 5, 0.03)


def run(*words: str | Path) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.stderr
    return result.stdout


def ate_m(clip: Path, calibration: Path, output: Path) -> float:
    """ATE (RMSE) of a run with a calibration, aligned without scale."""
    run("run", clip, "--calibration", calibration, "-o", output, "--quiet")
    figures = json.loads(run("eval", output, clip, "--json"))
    return float(figures["ate"]["translation_m"]["rmse"])


def film_board(folder: Path) -> None:
    rng = np.random.default_rng(3)
    for number, pose in enumerate(poses_around(BOARD, LEFT, 20)):
        assert RIG.cam1_from_cam0 is not None
        sides = (("left", LEFT, pose), ("right", RIGHT, RIG.cam1_from_cam0 @ pose))
        for side, camera, cam_from_board in sides:
            image = render(BOARD, camera, cam_from_board)
            noisy = np.clip(image + 2.0 * rng.standard_normal(image.shape), 0, 255)
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f"{number:03}.png"), noisy.astype(np.uint8))


def test_trajectory_is_as_accurate_as_with_the_true_calibration(tmp_path: Path) -> None:
    true, found, clip = tmp_path / "true.yaml", tmp_path / "found.yaml", tmp_path / "clip"
    write_calibration(true, RIG)
    world = ["--world", "room", "--motion", "handheld", "--effects", "none", "--set", "speed=1.5"]
    run("synth", clip, "--camera", true, *world, "--seconds", "2.5", "--fps", "12", "-q")
    film_board(tmp_path / "board")
    board = ["--board", "charuco", "--columns", "7", "--rows", "5", "--square", "0.03"]
    run("calibrate", tmp_path / "board", *board, "--model", "radtan", "-o", found)
    best = ate_m(clip, true, tmp_path / "out_true")
    with_found = ate_m(clip, found, tmp_path / "out_found")
    assert best < 0.01
    assert with_found < best + 0.002
