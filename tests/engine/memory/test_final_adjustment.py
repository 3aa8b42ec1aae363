"""Adjustment of the whole path at the end, with landmarks searched anew in all keyframes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from room_course import ate

from vo.base.config import PatchConfig, load_config
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.engine.backend.loop_adjustment import (
    AdjustedPath,
    Motions,
    path_covariance,
    path_information,
)
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.lazy_future import finished
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.frontend.patch_alignment import PatchAligner
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.inertial.joint_path import JointPaths
from vo.engine.memory import final_adjustment
from vo.engine.memory.rematching import PathViews, rematched, with_depths
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.inputs import load_inputs
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


def test_depths_of_landmarks_without_any_are_measured_in_the_pairs_of_all_keyframes() -> None:
    """Those of a landmark of which a disparity is known stay as they are."""
    rig = replace(_RIG, baseline_m=0.2)  # 10 px at the wall
    views, patches = _views(), PatchAligner(PatchConfig(half_px=4))
    is_even = views.point % 2 == 0
    views = replace(views, disparity=np.where(is_even, views.disparity, np.nan))
    shift, pairs = np.array([[1.0, 0.0, -10.0], [0.0, 1.0, 0.0]]), []
    for k, image in enumerate(views.images):
        right = cv2.warpAffine(image, shift, (320, 240))
        features = finished(OrbExtractor(load_config().features).extract(image))
        pairs.append(PreprocessedFrame(k, k, (image, right), (), (features, features)))
    found = rematched(views, views, rig, patches)
    stereo = make_frontend(load_config("best")).stereo
    both = with_depths(found, [*pairs[:-1], None], rig, stereo)
    is_new = (found.point % 2 == 1) & (found.keyframe < _COUNT - 1)
    np.testing.assert_array_equal(both.disparity[~is_new], found.disparity[~is_new])
    assert np.isfinite(both.disparity[is_new]).mean() > 0.9
    assert np.nanmedian(np.abs(both.disparity[is_new] - 10.0)) < 0.02
    assert np.isnan(both.disparity[found.keyframe == _COUNT - 1]).all()
    # A right image whose correction changed after its keyframe: as it would be measured now.
    later = replace(pairs[-1], corrected=VerticalDisparity(roll_px=0.5))
    turned = with_depths(found, [*pairs[:-1], later], rig, stereo)
    x = (found.image_xy[:, 0] - 10.0 - rig.cx) / rig.fx
    y = (found.image_xy[:, 1] - rig.cy) / rig.fy
    change = later.corrected.horizontal_px(x, y)
    off = turned.disparity[is_new] - both.disparity[is_new] - change[is_new]
    assert np.nanmax(np.abs(off)) < 0.01


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


def test_best_keeps_metre_and_vertical_of_an_inertial_sensor(
    shared_data: Path, tmp_path: Path
) -> None:
    hall = shared_data / "rendered_hall_stereo"
    in_metres, shape = {}, {}
    for rounds in (0, 2):
        config = load_config("best", ["memory.loops=false", f"refinement.rounds={rounds}"])
        run(hall, tmp_path / str(rounds), config=config, mode="mono")
        inputs = load_inputs(tmp_path / str(rounds) / "trajectory.tum", hall)
        for found, method in ((in_metres, "se3"), (shape, "sim3")):
            errors = evaluate(inputs.estimate, inputs.reference, method).ate.translation
            found[rounds] = errors.rmse
    assert shape[2] < 0.9 * shape[0]  # 0.0009 and 0.0013
    assert in_metres[2] < 1.2 * in_metres[0]  # 0.0054 and 0.0048


def test_two_cameras_follow_their_sensor_in_the_whole_adjustment(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall = shared_data / "rendered_hall_stereo"
    config = load_config("best", ["memory.loops=false", "refinement.rounds=1"])
    run(hall, tmp_path / "both", config=config)
    monkeypatch.setattr(JointPaths, "of", lambda *_: None)
    run(hall, tmp_path / "images", config=config)
    causal = [(tmp_path / name / "causal.tum").read_bytes() for name in ("both", "images")]
    assert causal[0] == causal[1]
    both, images = ate(tmp_path / "both", hall), ate(tmp_path / "images", hall)
    assert both != images and both < 1.05 * images


@pytest.mark.parametrize("has_sensor", [False, True])
def test_where_the_last_gate_disconnects_keyframes_the_round_before_is_kept(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_sensor: bool
) -> None:
    """Two cameras; beside a sensor the path of both stays as it was."""
    hall = shared_data / "rendered_hall_stereo"
    monkeypatch.setattr(final_adjustment, "_LAST_GATE", 1e-6)
    paths = []
    for rounds in (0, 1, 2):
        options = ["memory.loops=false", f"refinement.rounds={rounds}"]
        config = load_config("best", [*options, f"inertial.enabled={has_sensor}"])
        run(hall, tmp_path / str(rounds), config=config)
        paths.append((tmp_path / str(rounds) / "trajectory.tum").read_bytes())
    assert (paths[1] == paths[0]) == has_sensor
    assert (paths[2] == paths[0]) == has_sensor
    if not has_sensor:
        assert paths[2] != paths[1]
        assert ate(tmp_path / "2", hall) < 1.1 * ate(tmp_path / "0", hall)


def test_covariances_are_those_of_the_adjusted_path() -> None:
    """Further keyframes and further from the first one are less certain, by mm at 4 m."""
    views = _views()
    found = rematched(views, views, _RIG, PatchAligner(PatchConfig(half_px=4)))
    problem = found.problem(_RIG, 0.3)
    nothing = Motions(*(np.empty((0, *size)) for size in ((), (), (4, 4), (6, 6))))
    nothing = nothing._replace(earlier=np.empty(0, np.int64), later=np.empty(0, np.int64))
    path = AdjustedPath(found.world_from_cam, found.points)
    smoothing = load_config("best").smoothing
    covariance = path_covariance(path_information(problem, path, nothing, smoothing))
    assert covariance is not None
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    np.testing.assert_array_equal(sigma[0], 0.0)
    assert (np.diff(sigma[1:, 5]) > 0.0).all()
    assert 1e-4 < sigma[-1, 3:].max() < 0.05
    rest = {  # nothing by the last keyframe
        name: getattr(problem, name)[problem.keyframe < _COUNT - 1]
        for name in ("keyframe", "point", "xy", "disparity", "sigma_px")
    }
    rest_problem = replace(problem, **rest)
    assert path_covariance(path_information(rest_problem, path, nothing, smoothing)) is None
