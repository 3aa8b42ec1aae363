"""`Odometry.locate`: the pose before the map is extended, with the bits of `track`."""

from __future__ import annotations

import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from recorded_walk import CONFIG, Recording, Run

from vo.base.types import Estimate, Frame, Rig
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.odometry import Odometry


def located(rig: Rig, frames: Iterable[Frame]) -> tuple[list[Estimate], Odometry]:
    """Each pose at once, the map extended in another thread before the next frame."""
    odometry = Odometry(rig, CONFIG)
    estimates = []
    with ThreadPoolExecutor(1) as pool:
        for frame in frames:
            estimates.append(odometry.locate(frame))
            pool.submit(odometry.update_map).result()
    odometry.finish()
    odometry.close()
    return estimates, odometry


@pytest.fixture(scope="module")
def located_stereo(recording: Recording) -> tuple[list[Estimate], Odometry]:
    return located(recording.rig, recording.frames)


@pytest.mark.parametrize("kind", ["mono", "stereo"])
def test_poses_at_once_have_the_same_bits(
    kind: str, recording: Recording, request: pytest.FixtureRequest
) -> None:
    run: Run = request.getfixturevalue(kind)
    if kind == "stereo":
        estimates, odometry = request.getfixturevalue("located_stereo")
    else:
        estimates, odometry = located(recording.mono_rig, recording.mono())
    for estimate, expected in zip(estimates, run.estimates, strict=True):
        assert estimate.is_keyframe == expected.is_keyframe
        if expected.world_from_cam0 is None:
            assert estimate.world_from_cam0 is None
        else:
            np.testing.assert_array_equal(estimate.world_from_cam0, expected.world_from_cam0)
    path, expected_path = odometry.trajectory.trajectory(), run.odometry.trajectory.trajectory()
    np.testing.assert_array_equal(path.stamps_ns, expected_path.stamps_ns)
    np.testing.assert_array_equal(path.world_from_cam, expected_path.world_from_cam)


def test_keyframes_come_with_the_next_estimate(
    located_stereo: tuple[list[Estimate], Odometry],
) -> None:
    estimates, _ = located_stereo
    added = [e.frame_index for e in estimates[1:] if e.is_keyframe]
    assert len(added) >= 2
    for before, estimate in zip(estimates, estimates[1:], strict=False):
        new = [k.frame_index for k in estimate.keyframes]
        if before.is_keyframe and before.frame_index > 0:
            assert before.frame_index in new
        assert estimate.frame_index not in new


def test_frames_without_an_update_of_the_map_are_located_all_the_same(
    recording: Recording, stereo: Run
) -> None:
    odometry = Odometry(recording.rig, CONFIG)
    for frame, expected in zip(recording.frames, stereo.estimates, strict=True):
        estimate = odometry.locate(frame)
        assert expected.world_from_cam0 is not None
        np.testing.assert_array_equal(estimate.world_from_cam0, expected.world_from_cam0)
    odometry.close()


def test_windows_that_are_due_are_applied_before_the_frame(recording: Recording) -> None:
    odometry, moved_between = Odometry(recording.rig, CONFIG), 0
    for frame in recording.frames:
        before = [k.world_from_cam0 for k in odometry.trajectory.keyframes()]
        estimate = odometry.locate(frame)
        at_pose = [k.world_from_cam0 for k in odometry.trajectory.keyframes()]
        if len(before) == len(at_pose):
            np.testing.assert_array_equal(at_pose, before)
        odometry.update_map()
        after = [k.world_from_cam0 for k in odometry.trajectory.keyframes()]
        if not estimate.is_keyframe:
            moved_between += not np.array_equal(after, at_pose)
    odometry.close()
    assert moved_between >= 2


def test_features_wait_for_the_pose_where_there_is_time_between_frames(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    odometry, started = Odometry(recording.rig, CONFIG), []
    start = PreprocessedFrame.start_features
    monkeypatch.setattr(
        PreprocessedFrame, "start_features", lambda self: (started.append(self.index), start(self))
    )
    early, keyframes = [], 0
    for frame in recording.frames[:12]:
        odometry.locate(frame)
        early.append(frame.index in started)
        odometry.update_map()
        keyframes += started.count(frame.index) > early[-1]
        time.sleep(0.01)
    odometry.close()
    assert early[0] and not any(early[2:])
    assert keyframes >= 2
