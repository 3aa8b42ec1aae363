"""Two cameras close together, high above the ground: disparities of about a pixel."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from vo.base.config import Config
from vo.base.geometry.similarity import umeyama
from vo.base.types import Frame
from vo.engine.odometry import Odometry

FRAMES = range(10, 70)


def test_a_pair_high_above_the_ground_keeps_its_scale() -> None:
    recipe = load_recipe("aerial", ["mono=false", "scale=0.6", "seconds=4", "fps=20"])
    plan = make_plan(recipe)
    odometry = Odometry(plan.recording.rig, Config(threads=1))
    disparities_px = []
    with ThreadPoolExecutor() as pool:
        for index, shot in enumerate(render_frames(plan, pool, FRAMES)):
            left, right = shot.images
            assert left is not None
            estimate = odometry.track(Frame(index, round(index / recipe.fps * 1e9), (left, right)))
            assert estimate.world_from_cam0 is not None, estimate.failure
            disparities_px.append(estimate.median_disparity_px)
    odometry.finish()
    odometry.close()
    assert 0.5 < np.median(np.array(disparities_px, float)) < 2.0
    assert odometry.calibration_errors.disparity_offset_px == 0.0
    path = odometry.trajectory.trajectory().world_from_cam[:, :3, 3]
    truth = plan.recording.cam0_truth.world_from_cam[FRAMES.start : FRAMES.stop, :3, 3]
    fit = umeyama(path, truth, with_scale=True)
    assert abs(fit.scale - 1.0) < 0.01
    errors = fit.transform_points(path) - truth
    length = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    assert np.sqrt(np.mean(np.sum(errors**2, axis=1))) < 0.004 * length
