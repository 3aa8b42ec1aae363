"""Dark, missing and dropped frames during a walk, and other disturbances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recorded_walk import CONFIG, COUNT, Recording, Run, aligned, black, changed, track

from vo.base.types import Frame, State


def test_a_short_blackout_is_lost_and_then_recovered(recording: Recording) -> None:
    run = track(recording.rig, changed(recording.frames, range(20, 24), black))
    assert set(run.states[20:24]) == {State.LOST}
    assert all(e.world_from_cam0 is None and e.failure for e in run.estimates[20:24])
    assert set(run.states[:20] + run.states[24:]) == {State.TRACKING}
    assert run.numbers == [*range(20), *range(24, COUNT)]
    assert {e.segment for e in run.estimates} == {0}
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_a_long_blackout_begins_a_new_segment_and_keeps_the_old_poses(
    recording: Recording, stereo: Run
) -> None:
    run = track(recording.rig, changed(recording.frames, range(10, 30), black))
    assert run.segment(0) == list(range(10))
    assert run.segment(1) == list(range(30, COUNT))
    assert State.LOST in run.states[10:30] and State.TRACKING not in run.states[10:30]
    assert set(run.states[30:]) == {State.TRACKING}
    assert all(e.world_from_cam0 is None for e in run.estimates[10:30])
    np.testing.assert_allclose(run.path[:8], stereo.path[:8], atol=0.02)


def test_a_blackout_in_mono_keeps_what_there_is(recording: Recording) -> None:
    run = track(recording.mono_rig, changed(recording.mono(), range(18, 22), black))
    assert set(run.states[18:22]) == {State.LOST}
    assert not set(run.numbers) & set(range(18, 22))
    assert run.states[-1] is State.TRACKING
    assert len(run.numbers) > 25


def test_only_black_frames_end_without_a_path(recording: Recording) -> None:
    for rig, frames in ((recording.rig, recording.frames), (recording.mono_rig, recording.mono())):
        run = track(rig, [black(f) for f in frames[:5]])
        assert set(run.states) == {State.STARTING}
        assert run.numbers == [] and run.path.shape == (0, 4, 4)


def test_frames_without_a_right_image_are_tracked_all_the_same(recording: Recording) -> None:
    left_only = range(10, 22)
    frames = changed(recording.frames[:28], left_only, lambda f: replace(f, images=f.images[:1]))
    run = track(recording.rig, frames, takes_snapshots=True)
    assert set(run.states) == {State.TRACKING}
    assert run.numbers == list(range(28))
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.02 * recording.path_m
    for number in left_only:
        assert run.snapshots[number].view.image1 is None


def test_stereo_waits_for_a_right_image_to_start(recording: Recording) -> None:
    frames = changed(recording.frames[:6], range(3), lambda f: replace(f, images=f.images[:1]))
    run = track(recording.rig, frames)
    assert run.states == [State.STARTING] * 3 + [State.TRACKING] * 3
    assert run.numbers == [3, 4, 5]


def test_a_jump_in_time_and_place_does_not_make_a_wild_path(recording: Recording) -> None:
    frames = [f for f in recording.frames if not 15 <= f.index < 22]
    run = track(recording.rig, frames)
    steps = np.linalg.norm(np.diff(run.path[:, :3, 3], axis=0), axis=1)
    truth = recording.world_from_cam0[run.numbers][:, :3, 3]
    expected = np.linalg.norm(np.diff(truth, axis=0), axis=1)
    together = np.diff(run.odometry.trajectory.frames["segment"]) == 0
    np.testing.assert_allclose(steps[together], expected[together], atol=0.03)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_frames_that_were_lost_are_tracked_in_the_new_segment(
    recording: Recording, kind: str
) -> None:
    """From one frame to the next the camera is in another place: the room in a mirror."""

    def mirrored(frame: Frame) -> Frame:
        assert frame.image1 is not None
        pair = [np.ascontiguousarray(i[:, ::-1]) for i in (frame.image1, frame.image0)]
        return replace(frame, images=tuple(pair))

    frames = changed(recording.frames, range(14, COUNT), mirrored)
    rig = recording.rig
    if kind == "mono":
        rig, frames = recording.mono_rig, [replace(f, images=f.images[:1]) for f in frames]
    patience = CONFIG.tracking.model_copy(update={"recover_frames": 5})
    run = track(rig, frames, CONFIG.model_copy(update={"tracking": patience}))
    assert run.states[14:19] == [State.LOST] * 5
    assert run.segment(1) == list(range(14, COUNT))
    assert all(run.estimates[n].world_from_cam0 is None for n in range(14, 19))
    stamps_ns = run.odometry.trajectory.trajectory().stamps_ns
    assert np.all(np.diff(stamps_ns) > 0)


def test_five_dropped_frames_are_bridged(recording: Recording) -> None:
    dropped = range(15, 20)
    run = track(recording.rig, [f for f in recording.frames if f.index not in dropped])
    assert set(run.states) == {State.TRACKING}
    assert {e.segment for e in run.estimates} == {0}
    assert run.numbers == [n for n in range(COUNT) if n not in dropped]
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_a_change_of_exposure_is_survived(recording: Recording) -> None:
    def darker(frame: Frame) -> Frame:
        assert frame.image1 is not None
        pair = [np.round(0.6 * i + 15.0).astype(np.uint8) for i in (frame.image0, frame.image1)]
        return replace(frame, images=tuple(pair))

    run = track(recording.rig, changed(recording.frames[:28], range(14, 28), darker))
    assert set(run.states) == {State.TRACKING}
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.015 * recording.path_m
