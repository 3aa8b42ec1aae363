"""Keyframes that leave the local map arrive in a store, in runs of the whole odometry."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from vo.base.config import Config, load_config
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse, se3_exp, transform_points
from vo.base.types import Bytes, Frame, KeyframePose, Mode, Rig
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.keyframe_store import KeyframeStore, MemoryKeyframeStore, StoredLandmarks
from vo.engine.odometry import Odometry
from vo.engine.stages import Components
from vo.recordings.sources.registry import open_source

CAPACITY = 4
SETTINGS = (
    "smoothing.window=3",
    "smoothing.fixed=1",
    "keyframes.min_parallax_deg=0.4",
    "keyframes.min_parallax_mono_deg=0.4",
    "tracking.recover_frames=2",
)
CONFIG = load_config("fast", SETTINGS)  # keyframes often, of which the map holds few
COUNT = 18
BLACK = range(8, 13)  # long enough to give up the map


class RowStore:
    """A second store: keeps arrays by value, as one that writes to a database would."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, int, int]] = []  # id, frame, segment
        self.copies: list[tuple[Keyframe, StoredLandmarks]] = []
        self.images: list[Bytes] = []

    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        self.rows.append((keyframe.id, keyframe.frame.index, keyframe.frame.segment))
        self.copies.append(deepcopy((keyframe, landmarks())))
        self.images.append(image.copy())


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run and the store that took its keyframes."""

    odometry: Odometry
    rig: Rig
    frames: list[Frame]
    store: MemoryKeyframeStore

    @property
    def keyframes(self) -> list[KeyframePose]:
        """All keyframes of the run; a keyframe's id is its row."""
        return self.odometry.trajectory.keyframes()


def _track(
    rig: Rig, frames: Iterable[Frame], store: KeyframeStore | None, config: Config = CONFIG
) -> Odometry:
    odometry = Odometry(rig, config, Components(keyframe_store=store))
    for _ in odometry.track_all(frames):
        pass
    odometry.finish()
    odometry.close()
    return odometry


def _run(folder: Path, mode: Mode, change: Callable[[Frame], Frame] = lambda frame: frame) -> Run:
    source, store = open_source(folder, mode=mode), MemoryKeyframeStore()
    frames = [change(frame) for frame in source.frames(0, COUNT)]
    return Run(_track(source.rig, frames, store), source.rig, frames, store)


@pytest.fixture(scope="module", params=["stereo", "mono"])
def run(synthetic_stereo: Path, request: pytest.FixtureRequest) -> Run:
    return _run(synthetic_stereo, request.param)


def test_every_keyframe_arrives_once_in_the_order_of_ids(run: Run) -> None:
    """Those that have left the map, and those in it when the odometry was closed."""
    left = run.odometry.trajectory.keyframe_count
    assert left >= CAPACITY + 4
    assert [k.id for k in run.store.keyframes] == list(range(left))
    assert [k.frame.index for k in run.store.keyframes] == [
        k.frame_index for k in run.keyframes[:left]
    ]
    assert [k.frame.stamp_ns for k in run.store.keyframes] == [
        k.stamp_ns for k in run.keyframes[:left]
    ]
    assert {k.frame.segment for k in run.store.keyframes} == {0}
    assert list(run.store.landmarks) == list(range(left))


def test_descriptors_are_those_of_the_keypoints(run: Run) -> None:
    rig, extractor = rectified_rig(run.rig), OrbExtractor(CONFIG.features)
    width, dtype = extractor.descriptor_format
    for keyframe in run.store.keyframes:
        keypoints = keyframe.keypoints
        assert keypoints.descriptor.shape == (len(keypoints), width)
        assert keypoints.descriptor.dtype == dtype
        image = rig.rectify(run.frames[keyframe.frame.index].image0, 0)
        again = extractor.extract(image)
        np.testing.assert_array_equal(keypoints.xy, again.xy)
        np.testing.assert_array_equal(keypoints.descriptor, again.descriptor)


def test_landmarks_are_those_that_the_keyframe_observes_sorted_by_id(run: Run) -> None:
    width, dtype = OrbExtractor(CONFIG.features).descriptor_format
    for keyframe in run.store.keyframes:
        landmarks = run.store.landmarks[keyframe.id]
        count = len(landmarks.id)
        assert count > 100
        np.testing.assert_array_equal(landmarks.id, np.sort(keyframe.landmark))
        assert np.all(np.diff(landmarks.id) > 0)
        assert landmarks.descriptor.shape == (count, width)
        assert landmarks.descriptor.dtype == dtype
        assert landmarks.xyz.shape == landmarks.normal.shape == (count, 3)
        assert landmarks.octave.shape == landmarks.angle.shape == landmarks.sigma.shape == (count,)
        assert landmarks.sigma.min() > 0.0


def test_landmarks_lie_where_the_keyframe_observes_them(run: Run) -> None:
    rig = rectified_rig(run.rig)
    for keyframe in run.store.keyframes:
        landmarks = run.store.landmarks[keyframe.id]
        in_cam = transform_points(inverse(keyframe.world_from_cam), landmarks.xyz)
        observed_xy = keyframe.xy[np.argsort(keyframe.landmark)]
        errors_px = np.linalg.norm(rig.project(in_cam) - observed_xy, axis=1)
        assert np.median(errors_px) < 0.5
        assert np.quantile(errors_px, 0.95) < 2.5


def test_every_keyframe_has_a_covariance(run: Run) -> None:
    for keyframe in run.store.keyframes:
        assert keyframe.covariance is not None
        assert keyframe.covariance.shape == (6, 6)
    sizes = [float(np.trace(k.covariance)) for k in run.store.keyframes if k.covariance is not None]
    assert sizes[0] == 0.0 and min(sizes[1:]) > 0.0  # poses are relative to the first keyframe


def test_consecutive_keyframes_share_landmarks(run: Run) -> None:
    ids = [run.store.landmarks[k.id].id for k in run.store.keyframes]
    assert min(len(np.intersect1d(a, b)) for a, b in pairwise(ids)) > 50


def test_poses_are_those_of_the_trajectory(run: Run) -> None:
    """Of the rectified camera, while the trajectory has those of the recorded one."""
    cam0_from_rectified = rectified_rig(run.rig).cam0_from_rectified
    for keyframe, pose in zip(run.store.keyframes, run.keyframes, strict=False):
        expected = cam0_from_rectified @ keyframe.world_from_cam @ inverse(cam0_from_rectified)
        np.testing.assert_allclose(pose.world_from_cam0, expected, atol=1e-9)


def test_a_keyframe_that_left_can_be_moved_in_the_trajectory_by_its_id(
    synthetic_stereo: Path,
) -> None:
    run = _run(synthetic_stereo, "stereo")
    trajectory, keyframe = run.odometry.trajectory, run.store.keyframes[2]
    before, rows = trajectory.trajectory().world_from_cam, trajectory.frames["keyframe"].copy()
    move = se3_exp(np.array([0.0, 0.1, 0.0, 0.3, 0.0, 0.2]))
    (pose,) = trajectory.keyframes_by_id([keyframe.id])
    assert pose.frame_index == keyframe.frame.index
    trajectory.store(keyframe.id, replace(pose, world_from_cam0=move @ pose.world_from_cam0))
    after, moved = trajectory.trajectory().world_from_cam, rows == keyframe.id
    np.testing.assert_allclose(after[moved], move @ before[moved], atol=1e-9)
    np.testing.assert_array_equal(after[~moved], before[~moved])


def _black(frame: Frame) -> Frame:
    if frame.index not in BLACK:
        return frame
    dark = np.zeros_like(frame.image0)
    return replace(frame, images=(dark, None if frame.image1 is None else dark))


@pytest.fixture(scope="module")
def interrupted(synthetic_stereo: Path) -> Run:
    return _run(synthetic_stereo, "stereo", _black)


def test_at_the_start_of_a_new_segment_all_keyframes_of_the_old_map_arrive(
    interrupted: Run,
) -> None:
    run = interrupted
    segments = [k.segment for k in run.keyframes]
    of_first = segments.count(0)
    assert of_first > CAPACITY and segments.count(1) >= 1
    left = len(segments)
    assert [k.id for k in run.store.keyframes] == list(range(left))
    assert [k.frame.segment for k in run.store.keyframes] == segments[:left]
    for keyframe in run.store.keyframes:
        assert keyframe.covariance is not None
        landmarks = run.store.landmarks[keyframe.id]
        np.testing.assert_array_equal(landmarks.id, np.sort(keyframe.landmark))


def test_stores_of_two_kinds_receive_the_same_and_change_no_pose(interrupted: Run) -> None:
    run, rows = interrupted, RowStore()
    other = _track(run.rig, run.frames, rows)
    none = _track(run.rig, run.frames, None)
    assert rows.rows == [(k.id, k.frame.index, k.frame.segment) for k in run.store.keyframes]
    expected = run.odometry.trajectory.trajectory().world_from_cam
    for odometry in (other, none):
        np.testing.assert_array_equal(odometry.trajectory.trajectory().world_from_cam, expected)
    rig = rectified_rig(run.rig)
    for (keyframe, _), image in zip(rows.copies, rows.images, strict=True):
        expected_image = rig.rectify(run.frames[keyframe.frame.index].image0, 0)
        np.testing.assert_array_equal(image, expected_image)
    for keyframe, landmarks in rows.copies:  # what was handed over has not been changed since
        kept, kept_landmarks = run.store.keyframes[keyframe.id], run.store.landmarks[keyframe.id]
        np.testing.assert_array_equal(kept.world_from_cam, keyframe.world_from_cam)
        np.testing.assert_array_equal(kept.xy, keyframe.xy)
        for ours, theirs in zip(kept_landmarks, landmarks, strict=True):
            np.testing.assert_array_equal(ours, theirs)
