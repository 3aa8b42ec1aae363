"""The path so far, and how it follows its keyframes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from vo.base.geometry.transforms import interpolate, se3_exp, so3_exp
from vo.base.types import Floats, KeyframePose
from vo.engine.trajectory.inertial_frames import InertialFrame
from vo.engine.trajectory.interpolation import InterpolatedFrames
from vo.engine.trajectory.store import TrajectoryStore


def _pose(number: float) -> Floats:
    return se3_exp(np.array([0.02, -0.01, 0.03, 0.5, 0.1, 1.0]) * number)


def _put(store: TrajectoryStore, keyframe: int, frame: int, pose: Floats) -> None:
    store.store(keyframe, KeyframePose(frame, 100 * frame, 0, pose, None))


def _ten_frames() -> TrajectoryStore:
    """Frames 0 to 9, of which 0, 4 and 8 are keyframes."""
    store = TrajectoryStore()
    for frame in range(10):
        keyframe = frame // 4
        if frame % 4 == 0:
            _put(store, keyframe, frame, _pose(frame))
        store.add(frame, 100 * frame, 0, keyframe, _pose(frame))
    return store


def test_frames_have_the_poses_that_were_added() -> None:
    trajectory = _ten_frames().trajectory()
    assert trajectory.stamps_ns.tolist() == [100 * f for f in range(10)]
    expected = np.stack([_pose(f) for f in range(10)])
    np.testing.assert_allclose(trajectory.world_from_cam, expected, atol=1e-12)


def test_frames_move_with_their_keyframe_and_only_with_it() -> None:
    store = _ten_frames()
    move = se3_exp(np.array([0.1, 0.2, -0.1, 3.0, -1.0, 2.0]))
    _put(store, 1, 4, move @ _pose(4))
    found = store.trajectory().world_from_cam
    for frame in range(10):
        expected = move @ _pose(frame) if 4 <= frame < 8 else _pose(frame)
        np.testing.assert_allclose(found[frame], expected, atol=1e-12)


def _connected() -> TrajectoryStore:
    """Frames 0 to 9 as above, with keyframes that are connected."""
    store = TrajectoryStore()
    for frame in range(10):
        if frame % 4 == 0:
            _put(store, frame // 4, frame, _pose(frame))
            if frame:
                store.connect(frame // 4)
        store.add(frame, 100 * frame, 0, frame // 4, _pose(frame))
    return store


def test_frames_between_keyframes_share_what_moves_the_second_one() -> None:
    store = _connected()
    store.take_changes()
    turn, shift = np.array([0.1, 0.2, -0.1]), np.array([0.3, -0.1, 0.2])
    moved = _pose(8)
    moved[:3, :3], moved[:3, 3] = so3_exp(turn) @ moved[:3, :3], moved[:3, 3] + shift
    _put(store, 2, 8, moved)
    assert store.take_changes() == (4, 2)
    found = store.trajectory().world_from_cam
    np.testing.assert_allclose(found[8], moved, atol=1e-12)
    for frame, share in ((3, 0.0), (4, 0.0), (5, 0.25), (7, 0.75)):
        expected = _pose(frame)
        expected[:3, :3] = so3_exp(share * turn) @ expected[:3, :3]
        expected[:3, 3] += share * shift
        np.testing.assert_allclose(found[frame], expected, atol=1e-12)
    np.testing.assert_allclose(found[9], moved @ np.linalg.inv(_pose(8)) @ _pose(9), atol=1e-12)


def test_what_frames_measured_is_replaced_relative_to_their_keyframe() -> None:
    store = _connected()
    store.take_changes()
    # All motions since keyframe 1 were 5 % too long: its frames as measured again are right.
    _put(store, 2, 8, _pose(7.8))
    relative = np.stack([np.linalg.inv(_pose(4)) @ _pose(4 + 0.95 * n) for n in range(1, 5)])
    store.measure([5, 6, 7, 8], relative)
    assert store.take_changes() == (4, 2)
    found = store.trajectory().world_from_cam
    for n in range(5):
        np.testing.assert_allclose(found[4 + n], _pose(4 + 0.95 * n), atol=1e-12)
    np.testing.assert_allclose(found[9], _pose(7.8) @ _pose(1), atol=1e-12)


def test_path_tells_which_frames_are_keyframes() -> None:
    path = _ten_frames().path()
    assert path.frame_index.tolist() == list(range(10))
    assert np.flatnonzero(path.is_keyframe).tolist() == [0, 4, 8]
    assert not path.interpolated.any()


def test_only_what_is_new_or_has_moved_is_a_change() -> None:
    store = _ten_frames()
    assert store.take_changes() == (0, 0)
    assert store.take_changes() == (10, 3)
    _put(store, 1, 4, _pose(4.1))
    store.add(10, 1000, 0, 2, _pose(10))
    assert store.take_changes() == (4, 1)
    store.add(11, 1100, 0, 2, _pose(11))
    assert store.take_changes() == (11, 3)


def test_a_covariance_comes_out_as_it_went_in() -> None:
    root = np.random.default_rng(0).normal(size=(6, 6))
    store = TrajectoryStore()
    store.store(5, KeyframePose(7, 700, 2, _pose(1), root @ root.T))
    (only,) = store.keyframes()
    assert (only.frame_index, only.stamp_ns, only.segment) == (7, 700, 2)
    assert only.covariance is not None
    np.testing.assert_array_equal(only.covariance, root @ root.T)


STAMPS_NS = np.arange(40, dtype=np.int64) * 100 + np.arange(40) % 3 * 20  # uneven


def _every_third(numbers: Sequence[int], segment_of: Callable[[int], int]) -> TrajectoryStore:
    """Of frames in constant motion every third is tracked, every second of these a keyframe."""
    store = TrajectoryStore()
    store.interpolated = InterpolatedFrames(STAMPS_NS, 1, 3)
    for row, number in enumerate(numbers):
        stamp_ns, segment, pose = int(STAMPS_NS[number]), segment_of(number), _moving(number)
        if row % 2 == 0:
            store.store(row // 2, KeyframePose(number, stamp_ns, segment, pose, None))
        store.add(number, stamp_ns, segment, row // 2, pose)
    return store


def _moving(number: int) -> Floats:
    return _pose(float(STAMPS_NS[number]) / 100)


def test_frames_between_tracked_ones_are_interpolated_by_stamp() -> None:
    path = _every_third(range(0, 31, 3), lambda number: 0).path()
    assert path.frame_index.tolist() == list(range(31))
    assert np.flatnonzero(~path.interpolated).tolist() == list(range(0, 31, 3))
    np.testing.assert_array_equal(path.trajectory.stamps_ns, STAMPS_NS[:31])
    expected = np.stack([_moving(number) for number in range(31)])
    np.testing.assert_allclose(path.trajectory.world_from_cam, expected, atol=1e-9)


def test_nothing_is_interpolated_between_segments_or_over_a_lost_frame() -> None:
    numbers = [0, 3, 6, 12, 15, 18]  # 9 was lost, 15 begins a new segment
    path = _every_third(numbers, lambda number: int(number >= 15)).path()
    assert path.frame_index[path.interpolated].tolist() == [1, 2, 4, 5, 16, 17]


def test_interpolated_frames_move_with_either_neighbour() -> None:
    store = _every_third(range(0, 31, 3), lambda number: 0)
    store.take_changes()
    moved = _moving(12) @ se3_exp(np.array([0.0, 0.1, 0.0, 0.5, 0.0, 0.0]))
    store.store(2, KeyframePose(12, int(STAMPS_NS[12]), 0, moved, None))
    row, _ = store.take_changes()
    assert row == 10  # frame 9 stays, 10 and 11 lie between it and 12
    from_there, whole = store.trajectory(row), store.trajectory()
    np.testing.assert_array_equal(from_there.world_from_cam, whole.world_from_cam[row:])
    np.testing.assert_allclose(whole.world_from_cam[9], _moving(9), atol=1e-9)
    assert np.linalg.norm(whole.positions[10] - _moving(10)[:3, 3]) > 0.05


def test_an_old_keyframe_that_gets_a_new_pose_moves_exactly_its_frames() -> None:
    """As by a loop closure: keyframes 2 to 5 have come since, frames are their rows."""
    store = _every_third(range(0, 31, 3), lambda number: 0)
    before = store.trajectory().world_from_cam
    store.take_changes()
    covariance = 1e-4 * np.eye(6)
    move = se3_exp(np.array([0.1, 0.2, -0.1, 3.0, -1.0, 2.0]))
    store.store(1, KeyframePose(6, int(STAMPS_NS[6]), 0, move @ _moving(6), covariance))
    assert store.take_changes() == (4, 1)  # frames 4 and 5 lie between tracked frames 3 and 6
    assert store.take_changes() == (31, 6)

    after = store.trajectory().world_from_cam
    attached, others = list(range(6, 10)), [*range(4), *range(12, 31)]
    np.testing.assert_allclose(after[attached], move @ before[attached], atol=1e-9)
    np.testing.assert_array_equal(after[others], before[others])
    for number, first, last in ((4, 3, 6), (5, 3, 6), (10, 9, 12), (11, 9, 12)):
        begin, end = STAMPS_NS[first], STAMPS_NS[last]
        fraction = float((STAMPS_NS[number] - begin) / (end - begin))
        between = interpolate(after[first], after[last], fraction)
        np.testing.assert_allclose(after[number], between, atol=1e-9)
    np.testing.assert_array_equal(store.trajectory(4).world_from_cam, after[4:])

    keyframes = store.keyframes()
    assert [k.frame_index for k in keyframes] == list(range(0, 31, 6))
    np.testing.assert_allclose(keyframes[1].world_from_cam0, after[6], atol=1e-12)
    assert [k.covariance is not None for k in keyframes] == [False, True, *[False] * 4]


def test_the_oldest_of_several_moved_keyframes_is_the_first_change() -> None:
    store = _ten_frames()
    store.take_changes()
    for keyframe, frame in ((2, 8), (0, 0), (1, 4)):
        _put(store, keyframe, frame, _pose(frame + 0.1))
    assert store.take_changes() == (0, 0)
    _put(store, 2, 8, _pose(8))
    _put(store, 1, 4, _pose(4))
    assert store.take_changes() == (4, 1)


def test_without_frames_the_path_is_empty() -> None:
    trajectory = TrajectoryStore().trajectory()
    assert len(trajectory) == 0
    assert trajectory.positions.shape == (0, 3)


def test_moved_keyframes_are_returned_once_old_ones_too() -> None:
    store = _ten_frames()
    assert [k.frame_index for k in store.take_moved()] == [0, 4, 8]
    assert store.take_moved() == ()
    _put(store, 0, 0, _pose(0.5))
    (moved,) = store.take_moved()
    np.testing.assert_array_equal(moved.world_from_cam0, _pose(0.5))


def _with_a_gap() -> TrajectoryStore:
    """Frames 0 to 9 without 5 and 6, of which 0, 4 and 8 are keyframes, with known covariances."""
    store = TrajectoryStore()
    for frame in (0, 1, 2, 3, 4, 7, 8, 9):
        keyframe = frame // 4
        if frame % 4 == 0:
            pose = KeyframePose(frame, 100 * frame, 0, _pose(frame), 1e-4 * np.eye(6))
            store.store(keyframe, pose)
        store.add(frame, 100 * frame, 0, keyframe, _pose(frame))
    return store


def _inertial(frame: int) -> InertialFrame:
    return InertialFrame(1, frame, 100 * frame, 0, _pose(frame), 1e-3 * np.eye(6))


def test_frames_by_an_inertial_sensor_are_in_the_path_and_marked() -> None:
    store = _with_a_gap()
    store.take_changes()
    store.add_inertial([_inertial(5), _inertial(6)])
    assert store.take_changes() == (0, 0)  # everything after them has other rows
    path = store.path()
    assert path.frame_index.tolist() == list(range(10)) and path.inertial is not None
    assert path.inertial.tolist() == [0] * 5 + [-1] * 2 + [0] * 3
    assert np.flatnonzero(path.is_keyframe).tolist() == [0, 4, 8] and not path.interpolated.any()
    expected = np.stack([_pose(f) for f in range(10)])
    np.testing.assert_allclose(path.trajectory.world_from_cam, expected, atol=1e-12)


def test_frames_by_an_inertial_sensor_move_with_the_keyframe_before_them() -> None:
    store = _with_a_gap()
    store.move_keyframes(
        np.array([1]), np.array([0]), _pose(4)[None], np.array([2.0]), np.zeros((1, 6, 6))
    )
    store.add_inertial([_inertial(5)])
    np.testing.assert_allclose(store.trajectory().world_from_cam[5], _pose(5), atol=1e-12)
    move = se3_exp(np.array([0.1, 0.2, -0.1, 3.0, -1.0, 2.0]))
    moved = (move @ _pose(4))[None]
    store.move_keyframes(np.array([1]), np.array([0]), moved, np.array([2.0]), np.zeros((1, 6, 6)))
    np.testing.assert_allclose(store.trajectory().world_from_cam[5], move @ _pose(5), atol=1e-12)


def test_frames_by_an_inertial_sensor_have_covariances_among_those_of_keyframes() -> None:
    store = _with_a_gap()
    assert [pose.frame_index for pose in store.covariances(1)] == [4, 8]
    store.add_inertial([_inertial(5), _inertial(6)])
    poses = store.covariances()
    assert [pose.frame_index for pose in poses] == [0, 4, 5, 6, 8]
    assert [float(np.trace(p.covariance)) for p in poses if p.covariance is not None] == [
        pytest.approx(6 * v) for v in (1e-4, 1e-4, 1e-3, 1e-3, 1e-4)
    ]


def test_keyframes_that_are_stored_together_are_as_if_stored_one_by_one() -> None:
    rng = np.random.default_rng(2)
    stores = TrajectoryStore(), TrajectoryStore()
    poses = []
    for number in range(5):
        root = rng.normal(size=(6, 6))
        covariance = None if number == 2 else root @ root.T
        segment = int(number > 3)
        poses.append(KeyframePose(number, 100 * number, segment, _pose(number), covariance))
    moved = [replace(pose, world_from_cam0=pose.world_from_cam0 @ _pose(0.1)) for pose in poses]
    for store in stores:
        for number, pose in enumerate(poses[:2]):
            store.store(number, pose)
            store.add(number, 100 * number, 0, number, pose.world_from_cam0)
        store.move_keyframes(
            np.array([0]), np.array([0]), _pose(3)[None], np.array([2.0]), np.eye(6)[None]
        )
        store.take_changes()
        store.take_moved()
    stores[0].store_all(range(5), moved)
    for number, pose in enumerate(moved):
        stores[1].store(number, pose)
    assert stores[0].take_changes() == stores[1].take_changes() == (0, 0)
    for one, other in zip(stores[0].take_moved(), stores[1].take_moved(), strict=True):
        assert (one.frame_index, one.segment, one.scale) == (
            *(other.frame_index, other.segment, other.scale),
        )
        np.testing.assert_array_equal(one.world_from_cam0, other.world_from_cam0)
        if one.frame_index == 2:
            assert one.covariance is other.covariance is None
        else:
            np.testing.assert_array_equal(one.covariance, other.covariance)


def test_what_the_path_would_be_changes_nothing() -> None:
    store = _with_a_gap()
    here = np.array([1]), np.array([0])
    store.move_keyframes(*here, _pose(4)[None], np.array([2.0]), 1e-4 * np.eye(6)[None])
    store.take_changes(), store.take_moved()
    before, anchor, poses = store.trajectory().world_from_cam, store.anchor(0), store.keyframes()
    move = se3_exp(np.array([0.1, 0.2, -0.1, 3.0, -1.0, 2.0]))
    found = store.trajectory_with(*here, (move @ _pose(4))[None], np.array([1.0]))
    expected = np.stack([move @ _pose(frame) for frame in (0, 1, 2, 3, 4, 7, 8, 9)])
    np.testing.assert_allclose(found.world_from_cam, expected, atol=1e-12)
    np.testing.assert_array_equal(store.trajectory().world_from_cam, before)
    assert store.anchor(0) is anchor and store.take_moved() == ()
    assert store.take_changes() == (len(before), len(poses))
    for one, other in zip(store.keyframes(), poses, strict=True):
        np.testing.assert_array_equal(one.covariance, other.covariance)
