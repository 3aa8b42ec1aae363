"""A walk with one camera, end to end."""

from __future__ import annotations

import cv2
import numpy as np
from recorded_walk import COUNT, Recording, Run, aligned, track

from vo.base.types import Frame, State


def test_mono_tracks_on_once_it_has_started(mono: Run) -> None:
    started = mono.states.index(State.TRACKING)
    assert started < 15  # a second
    assert set(mono.states[:started]) <= {State.STARTING}
    assert set(mono.states[started:]) == {State.TRACKING}
    assert set(range(started, COUNT)) <= set(mono.numbers)
    assert {e.segment for e in mono.estimates} == {0}


def test_mono_errs_by_less_than_a_hundredth_of_the_path(mono: Run, recording: Recording) -> None:
    ate, _ = aligned(mono, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m


def test_frames_before_the_mono_start_have_a_failure(mono: Run) -> None:
    for estimate in mono.estimates:
        assert (estimate.failure is not None) == (estimate.state is State.STARTING)


def test_a_right_image_is_ignored_by_a_mono_rig(mono: Run, recording: Recording) -> None:
    run = track(recording.mono_rig, recording.frames[:15])
    np.testing.assert_array_equal(
        [e.world_from_cam0 is None for e in run.estimates],
        [e.world_from_cam0 is None for e in mono.estimates[:15]],
    )


def test_standing_still_in_mono_never_makes_a_map(recording: Recording) -> None:
    rng = np.random.default_rng(0)
    still = recording.frames[0].image0.astype(np.int16)
    frames = []
    for index in range(25):
        noisy = still + np.round(rng.normal(0, 3, still.shape)).astype(np.int16)
        image = np.clip(noisy, 0, 255).astype(np.uint8)
        frames.append(Frame(index, index * 66_000_000, (image,)))
    run = track(recording.mono_rig, frames)
    assert set(run.states) == {State.STARTING}
    assert run.numbers == []
    assert all(e.failure for e in run.estimates)


def test_turning_on_the_spot_in_mono_never_makes_a_map(recording: Recording) -> None:
    matrix = recording.rig.cam0.matrix
    frames = []
    for index in range(20):
        turn = cv2.Rodrigues(np.array([0.0, 0.012 * index, 0.0]))[0]
        move = matrix @ turn @ np.linalg.inv(matrix)
        image = cv2.warpPerspective(recording.frames[0].image0, move, (480, 300))
        frames.append(Frame(index, index * 66_000_000, (np.asarray(image, dtype=np.uint8),)))
    assert track(recording.mono_rig, frames).numbers == []
