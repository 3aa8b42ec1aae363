"""Odometry on input with defects, end to end on rendered images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_walk import Recording, Run, aligned, track

from vo.base.config import StereoConfig, load_config
from vo.base.errors import SourceError
from vo.base.types import State
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source

FAST = load_config("fast", ["threads=1"])
COUNT = 30


@pytest.fixture(scope="module")
def recording(synthetic_stereo: Path) -> Recording:
    source = open_source(synthetic_stereo)
    truth = read_tum(synthetic_stereo / "groundtruth.tum")
    return Recording(source.rig, tuple(source.frames()), truth.world_from_cam)


@pytest.mark.parametrize("corrects_rows", [True, False])
def test_swapped_cameras_are_refused(recording: Recording, corrects_rows: bool) -> None:
    config = FAST.model_copy(update={"stereo": StereoConfig(row_correction=corrects_rows)})
    frame = recording.frames[0]
    with pytest.raises(SourceError, match="left and right images are exchanged"):
        track(recording.rig, [replace(frame, images=frame.images[::-1])], config)


def test_right_images_that_are_upside_down_are_refused(recording: Recording) -> None:
    frame = recording.frames[0]
    upside_down = replace(frame, images=(frame.image0, np.ascontiguousarray(frame.image0[::-1])))
    with pytest.raises(SourceError, match="the right image is mirrored top to bottom"):
        track(recording.rig, [upside_down], FAST)


def test_a_stretch_without_right_images_is_tracked_in_one_segment(recording: Recording) -> None:
    left_only = range(10, 20)
    frames = [
        replace(f, images=f.images[:1]) if f.index in left_only else f for f in recording.frames
    ]
    run = track(recording.rig, frames, FAST)
    assert {e.state for e in run.estimates} == {State.TRACKING}
    assert run.segment(0) == run.numbers == list(range(COUNT))
    assert any(run.estimates[number].is_keyframe for number in left_only)
    assert min(e.inliers for e in run.estimates) > 150
    assert aligned(run, recording, with_scale=False)[0] < 0.01


def test_few_landmarks_in_the_window_are_enough(recording: Recording) -> None:
    smoothing = FAST.smoothing.model_copy(update={"max_landmarks": 150})
    config = FAST.model_copy(update={"smoothing": smoothing})
    run = track(recording.rig, recording.frames, config)
    assert run.segment(0) == run.numbers == list(range(COUNT))
    assert aligned(run, recording, with_scale=False)[0] < 0.01


def test_every_second_frame_is_enough(recording: Recording) -> None:
    run = track(recording.rig, recording.frames[::2], FAST)
    assert {e.state for e in run.estimates} == {State.TRACKING}
    assert run.segment(0) == run.numbers == list(range(0, COUNT, 2))
    assert aligned(run, recording, with_scale=False)[0] < 0.01


@pytest.fixture(scope="module")
def mono(recording: Recording) -> Run:
    return track(recording.mono_rig, recording.mono()[:15], FAST)


def test_frames_that_waited_for_the_first_mono_map_are_tracked_in_it(mono: Run) -> None:
    second = [e.state for e in mono.estimates].index(State.TRACKING)
    assert second >= 2  # so there are some that waited
    assert mono.numbers == list(range(15))
    keyframes = mono.odometry.trajectory.keyframes()
    assert [k.frame_index for k in keyframes[:2]] == [0, second]
    assert np.all(np.diff(mono.odometry.trajectory.trajectory().stamps_ns) > 0)


def test_frames_that_waited_have_no_causal_pose(mono: Run) -> None:
    second = [e.state for e in mono.estimates].index(State.TRACKING)
    for number, estimate in enumerate(mono.estimates):
        assert (estimate.world_from_cam0 is None) == (number < second)
        assert (estimate.state is State.STARTING) == (number < second)


def test_frames_that_waited_are_as_exact_as_the_others(mono: Run, recording: Recording) -> None:
    second = [e.state for e in mono.estimates].index(State.TRACKING)
    ate, fit = aligned(mono, recording, with_scale=True)
    assert ate < 0.01
    away = fit.transform_points(mono.path[:second, :3, 3])
    away -= recording.world_from_cam0[:second, :3, 3]
    assert np.linalg.norm(away, axis=1).max() < 0.01


def test_a_blind_frame_that_waited_is_not_given_a_pose(recording: Recording) -> None:
    first, *others = recording.mono()[:15]
    dark = replace(first, images=(np.zeros_like(first.image0),))
    run = track(recording.mono_rig, [dark, *others], FAST)
    assert run.numbers == list(range(1, 15))
