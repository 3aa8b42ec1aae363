"""Right images that are of no use: the left camera carries on in the same map, in metres."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from recorded_walk import CONFIG, COUNT, Recording, Run, aligned, changed, track

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from vo.base.config import Config
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.similarity import umeyama
from vo.base.types import Bytes, Frame, State
from vo.engine.mapping.keyframe_store import MemoryKeyframeStore
from vo.engine.odometry import Odometry
from vo.engine.stages import Components

RNG = np.random.default_rng(0)
ALONE = Fault(FaultKind.LEFT_CAMERA_ALONE, is_handled=True)
HIDDEN = range(12, 30)


def covered(image: Bytes) -> Bytes:
    return RNG.integers(6, 14, image.shape).astype(np.uint8)


def dirty(image: Bytes) -> Bytes:
    return RNG.integers(0, 256, image.shape).astype(np.uint8)


def with_right(change: Callable[[Bytes], Bytes]) -> Callable[[Frame], Frame]:
    def apply(frame: Frame) -> Frame:
        assert frame.image1 is not None
        return replace(frame, images=(frame.image0, change(frame.image1)))

    return apply


@pytest.mark.parametrize("change", [covered, dirty])
def test_a_useless_right_image_is_told_and_the_path_stays_metric(
    recording: Recording, change: Callable[[Bytes], Bytes]
) -> None:
    run = track(recording.rig, changed(recording.frames, HIDDEN, with_right(change)))
    assert set(run.states) == {State.TRACKING}
    assert run.numbers == list(range(COUNT))
    assert [n for n, e in enumerate(run.estimates) if ALONE in e.faults] == list(HIDDEN)
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_keyframes_by_the_left_camera_alone_are_doubted_and_no_others(recording: Recording) -> None:
    store = MemoryKeyframeStore()
    odometry = Odometry(recording.rig, CONFIG, Components(keyframe_store=store))
    for frame in changed(recording.frames, HIDDEN, with_right(covered)):
        odometry.track(frame)
    odometry.close()
    alone = [keyframe for keyframe in store.keyframes if keyframe.frame.index in HIDDEN]
    assert alone
    assert [keyframe for keyframe in store.keyframes if keyframe.is_doubted] == alone


def test_good_pairs_are_no_fault(stereo: Run) -> None:
    assert all(e.faults == () for e in stereo.estimates)


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


def test_cameras_that_change_places_are_a_fault(recording: Recording, stereo: Run) -> None:
    def exchanged(frame: Frame) -> Frame:
        return replace(frame, images=frame.images[::-1])

    run = track(recording.rig, changed(recording.frames, range(20, COUNT), exchanged))
    kinds = {fault.kind: fault.is_handled for e in run.estimates for fault in e.faults}
    assert kinds[FaultKind.EXCHANGED_IMAGES] is False
    assert all(f.kind != FaultKind.EXCHANGED_IMAGES for e in stereo.estimates for f in e.faults)
