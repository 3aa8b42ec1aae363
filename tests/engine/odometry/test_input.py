"""Odometry on input with defects, end to end on rendered images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from vo.base.config import Config, StereoConfig, load_config
from vo.base.errors import SourceError
from vo.base.geometry.similarity import umeyama
from vo.base.types import Estimate, Floats, Frame, Rig, State
from vo.engine.odometry import Odometry
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source

FAST = load_config("fast", ["threads=1"])
COUNT = 30


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of the synthetic walk and their true poses."""

    rig: Rig
    frames: list[Frame]
    world_from_cam0: Floats


@dataclass(frozen=True, eq=False)
class Run:
    """Results of the odometry, and the numbers of the frames that have a pose."""

    odometry: Odometry
    estimates: list[Estimate]

    @property
    def numbers(self) -> list[int]:
        return [int(f) for f in self.odometry.trajectory.frames["frame_index"]]

    @property
    def segments(self) -> set[int]:
        return {int(s) for s in self.odometry.trajectory.frames["segment"]}

    def errors_m(self, recording: Recording, *, with_scale: bool = False) -> Floats:
        """Distances of the smoothed positions from the truth after alignment."""
        found = self.odometry.trajectory.trajectory().positions
        truth = recording.world_from_cam0[self.numbers][:, :3, 3]
        fit = umeyama(found, truth, with_scale=with_scale)
        return np.asarray(np.linalg.norm(fit.transform_points(found) - truth, axis=1))


@pytest.fixture(scope="module")
def recording(synthetic_stereo: Path) -> Recording:
    source = open_source(synthetic_stereo)
    truth = read_tum(synthetic_stereo / "groundtruth.tum")
    return Recording(source.rig, list(source.frames()), truth.world_from_cam)


def _run(rig: Rig, frames: Iterable[Frame], config: Config = FAST) -> Run:
    odometry = Odometry(rig, config)
    return Run(odometry, [odometry.track(frame) for frame in frames])


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def test_swapped_cameras_are_refused(recording: Recording) -> None:
    frame = recording.frames[0]
    with pytest.raises(SourceError, match="left and right images are exchanged"):
        _run(recording.rig, [replace(frame, images=frame.images[::-1])])


def test_the_pair_is_checked_without_row_correction_too(recording: Recording) -> None:
    config = FAST.model_copy(update={"stereo": StereoConfig(row_correction=False)})
    frame = recording.frames[0]
    with pytest.raises(SourceError, match="left and right images are exchanged"):
        _run(recording.rig, [replace(frame, images=frame.images[::-1])], config)


def test_right_images_that_are_upside_down_are_refused(recording: Recording) -> None:
    frame = recording.frames[0]
    upside_down = replace(frame, images=(frame.image0, np.ascontiguousarray(frame.image0[::-1])))
    with pytest.raises(SourceError, match="the right image is mirrored top to bottom"):
        _run(recording.rig, [upside_down])


def test_a_stretch_without_right_images_is_tracked_in_one_segment(recording: Recording) -> None:
    left_only = range(10, 20)
    frames = [
        replace(f, images=f.images[:1]) if f.index in left_only else f for f in recording.frames
    ]
    run = _run(recording.rig, frames)
    assert {e.state for e in run.estimates} == {State.TRACKING}
    assert run.numbers == list(range(COUNT))
    assert run.segments == {0}
    assert any(run.estimates[number].is_keyframe for number in left_only)
    assert min(e.inliers for e in run.estimates) > 150
    assert _rms(run.errors_m(recording)) < 0.01


def test_few_landmarks_in_the_window_are_enough(recording: Recording) -> None:
    smoothing = FAST.smoothing.model_copy(update={"max_landmarks": 150})
    config = FAST.model_copy(update={"smoothing": smoothing})
    run = _run(recording.rig, recording.frames, config)
    assert run.numbers == list(range(COUNT))
    assert run.segments == {0}
    assert _rms(run.errors_m(recording)) < 0.01


def test_every_second_frame_is_enough(recording: Recording) -> None:
    run = _run(recording.rig, recording.frames[::2])
    assert {e.state for e in run.estimates} == {State.TRACKING}
    assert run.numbers == list(range(0, COUNT, 2))
    assert run.segments == {0}
    assert _rms(run.errors_m(recording)) < 0.01


@pytest.fixture(scope="module")
def mono(recording: Recording) -> Run:
    frames = [replace(f, images=f.images[:1]) for f in recording.frames[:15]]
    return _run(Rig(recording.rig.cam0), frames)


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
    errors = mono.errors_m(recording, with_scale=True)
    assert _rms(errors) < 0.01
    assert errors[:second].max() < 0.01


def test_a_blind_frame_that_waited_is_not_given_a_pose(recording: Recording) -> None:
    frames = [replace(f, images=f.images[:1]) for f in recording.frames[:15]]
    frames[0] = replace(frames[0], images=(np.zeros_like(frames[0].image0),))
    run = _run(Rig(recording.rig.cam0), frames)
    assert run.numbers == list(range(1, 15))
