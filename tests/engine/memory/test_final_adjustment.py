"""Adjustment of the whole path at the end, with landmarks searched anew in all keyframes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from room_course import ate

from vo.base.config import PatchConfig, load_config
from vo.base.geometry.rectification import RectifiedRig
from vo.engine.frontend.patch_alignment import PatchAligner
from vo.engine.memory.rematching import PathViews, rematched
from vo.runs.run_recording import run

_RIG = RectifiedRig(320, 240, 200.0, 200.0, 160.0, 120.0, 0.0, np.eye(4))
_STEP_PX, _DEPTH, _COUNT = 7.25, 4.0, 6


def _views() -> PathViews:
    """A camera that moves along a wall, whose landmarks only the first two keyframes observe."""
    random = np.random.default_rng(2)
    noise = random.integers(0, 255, (240, 500)).astype(np.uint8)
    wall = cv2.GaussianBlur(noise, (0, 0), 2.0)
    wall = cv2.normalize(wall, None, 0, 255, cv2.NORM_MINMAX)
    images, poses = [], np.tile(np.eye(4), (_COUNT, 1, 1))
    for k in range(_COUNT):
        shift = np.array([[1.0, 0.0, -_STEP_PX * k], [0.0, 1.0, 0.0]])
        images.append(cv2.warpAffine(wall, shift, (320, 240), flags=cv2.INTER_CUBIC))
        poses[k, 0, 3] = _STEP_PX * k * _DEPTH / _RIG.fx
    u, v = (
        each.ravel() for each in np.meshgrid(np.arange(80.0, 300, 20), np.arange(30.0, 220, 20))
    )
    xy, count = np.stack([u, v], axis=1), len(u)
    points = np.column_stack([(u - 160) / 200 * _DEPTH, (v - 120) / 200 * _DEPTH, u * 0 + _DEPTH])
    return PathViews(
        np.stack(images),
        [None] * _COUNT,
        poses,
        points,
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.repeat([0, 1], count),
        np.tile(np.arange(count), 2),
        np.concatenate([xy, xy - [_STEP_PX, 0.0]]),
        np.concatenate([np.full(count, 3.0), np.full(count, np.nan)]),
        np.full(2 * count, 0.5),
    )


def test_landmarks_are_found_in_all_keyframes_that_show_them() -> None:
    views = _views()
    found = rematched(views, views, _RIG, PatchAligner(PatchConfig(half_px=4)))
    assert (np.diff(found.keyframe) >= 0).all()
    assert np.bincount(found.keyframe).min() > 0.95 * len(views.points)
    expected = views.image_xy[found.point] - np.outer(found.keyframe, [_STEP_PX, 0.0])
    off = np.linalg.norm(found.image_xy - expected, axis=1)
    assert np.median(off) < 0.03
    assert off.max() < 0.3
    known = np.isfinite(found.disparity)
    assert (found.keyframe[known] == 0).all()
    assert np.count_nonzero(known) == len(views.points)


def test_nothing_is_searched_behind_a_mask_or_outside_of_the_image() -> None:
    views = _views()
    mask = np.full((240, 320), 255, np.uint8)
    mask[:, :200] = 0
    masked = replace(views, masks=[*[None] * (_COUNT - 1), mask])
    found = rematched(masked, views, _RIG, PatchAligner(PatchConfig(half_px=4)))
    last = found.image_xy[found.keyframe == _COUNT - 1]
    assert len(last) > 20
    assert last[:, 0].min() > 199.0
    far = views.world_from_cam.copy()
    far[-1, 0, 3] = 100.0
    found = rematched(
        replace(views, world_from_cam=far), views, _RIG, PatchAligner(PatchConfig(half_px=4))
    )
    assert found.keyframe.max() == _COUNT - 2


def test_best_lowers_the_error_of_one_camera_and_leaves_causal_poses(
    shared_data: Path, tmp_path: Path
) -> None:
    hall = shared_data / "rendered_hall_stereo"
    options = ["inertial.enabled=false", "memory.loops=false"]
    rounds = {"no": "refinement.rounds=0", "best": "refinement.rounds=3"}
    error = {}
    for name, setting in {"default": "", **rounds}.items():
        preset = "default" if name == "default" else "best"
        config = load_config(preset, [*options, *([setting] if setting else [])])
        run(hall, tmp_path / name, config=config, mode="mono")
        error[name] = ate(tmp_path / name, hall)
    assert error["best"] < 0.8 * error["default"]
    causal = [(tmp_path / name / "causal.tum").read_bytes() for name in rounds]
    assert causal[0] == causal[1]
    paths = [(tmp_path / name / "trajectory.tum").read_bytes() for name in rounds]
    assert paths[0] != paths[1]
