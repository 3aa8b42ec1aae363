"""The path so far, the watch over disparities, the stopwatch."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from vo.geometry.transforms import se3_exp
from vo.stopwatch import Stopwatch
from vo.trajectory.store import InterpolatedFrames, TrajectoryStore
from vo.types import Floats, KeyframePose

# TrajectoryStore


def _pose(number: float) -> Floats:
    return se3_exp(np.array([0.02, -0.01, 0.03, 0.5, 0.1, 1.0]) * number)


def _store(history: TrajectoryStore, keyframe: int, frame: int, pose: Floats) -> None:
    history.store(keyframe, KeyframePose(frame, 100 * frame, 0, pose, None))


def _history() -> TrajectoryStore:
    """Frames 0 to 9, of which 0, 4 and 8 are keyframes."""
    history = TrajectoryStore()
    for frame in range(10):
        keyframe = frame // 4
        if frame % 4 == 0:
            _store(history, keyframe, frame, _pose(frame))
        history.add(frame, 100 * frame, 0, keyframe, _pose(frame))
    return history


def test_frames_are_where_they_were_put() -> None:
    trajectory = _history().trajectory()
    assert trajectory.stamps_ns.tolist() == [100 * f for f in range(10)]
    expected = np.stack([_pose(f) for f in range(10)])
    np.testing.assert_allclose(trajectory.world_from_cam, expected, atol=1e-12)


def test_frames_move_with_their_keyframe_and_only_with_it() -> None:
    history = _history()
    move = se3_exp(np.array([0.1, 0.2, -0.1, 3.0, -1.0, 2.0]))
    _store(history, 1, 4, move @ _pose(4))
    found = history.trajectory().world_from_cam
    for frame in range(10):
        expected = move @ _pose(frame) if 4 <= frame < 8 else _pose(frame)
        np.testing.assert_allclose(found[frame], expected, atol=1e-12)


def test_the_path_says_which_frames_are_keyframes() -> None:
    path = _history().path()
    assert path.frame_index.tolist() == list(range(10))
    assert np.flatnonzero(path.is_keyframe).tolist() == [0, 4, 8]
    assert not path.interpolated.any()


def test_only_what_is_new_or_has_moved_is_a_change() -> None:
    history = _history()
    assert history.take_changes() == (0, 0)
    assert history.take_changes() == (10, 3)
    _store(history, 1, 4, _pose(4.1))
    history.add(10, 1000, 0, 2, _pose(10))
    assert history.take_changes() == (4, 1)
    history.add(11, 1100, 0, 2, _pose(11))
    assert history.take_changes() == (11, 3)


def test_a_covariance_comes_out_as_it_went_in() -> None:
    root = np.random.default_rng(0).normal(size=(6, 6))
    history = TrajectoryStore()
    history.store(5, KeyframePose(7, 700, 2, _pose(1), root @ root.T))
    (only,) = history.keyframes()
    assert (only.frame_index, only.stamp_ns, only.segment) == (7, 700, 2)
    assert only.covariance is not None
    np.testing.assert_array_equal(only.covariance, root @ root.T)


STAMPS_NS = np.arange(40, dtype=np.int64) * 100 + np.arange(40) % 3 * 20  # uneven


def _every_third(numbers: Sequence[int], segment_of: Callable[[int], int]) -> TrajectoryStore:
    """Of frames in constant motion every third is tracked, every second of these a keyframe."""
    history = TrajectoryStore()
    history.untracked = InterpolatedFrames(STAMPS_NS, 1, 3)
    for row, number in enumerate(numbers):
        stamp_ns, segment, pose = int(STAMPS_NS[number]), segment_of(number), _moving(number)
        if row % 2 == 0:
            history.store(row // 2, KeyframePose(number, stamp_ns, segment, pose, None))
        history.add(number, stamp_ns, segment, row // 2, pose)
    return history


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
    history = _every_third(range(0, 31, 3), lambda number: 0)
    history.take_changes()
    moved = _moving(12) @ se3_exp(np.array([0.0, 0.1, 0.0, 0.5, 0.0, 0.0]))
    history.store(2, KeyframePose(12, int(STAMPS_NS[12]), 0, moved, None))
    row, _ = history.take_changes()
    assert row == 10  # frame 9 stays, 10 and 11 lie between it and 12
    from_there, whole = history.trajectory(row), history.trajectory()
    np.testing.assert_array_equal(from_there.world_from_cam, whole.world_from_cam[row:])
    np.testing.assert_allclose(whole.world_from_cam[9], _moving(9), atol=1e-9)
    assert np.linalg.norm(whole.positions[10] - _moving(10)[:3, 3]) > 0.05


def test_without_frames_the_path_is_empty() -> None:
    trajectory = TrajectoryStore().trajectory()
    assert len(trajectory) == 0
    assert trajectory.positions.shape == (0, 3)


# Stopwatch


def test_each_stage_is_counted_and_repeated_ones_are_added() -> None:
    clock = Stopwatch()
    for name in ("match", "align", "match"):
        before = clock.stage_ms.get(name, 0.0)
        with clock.stage(name):
            sum(range(1000))
        assert clock.stage_ms[name] > before
    assert list(clock.stage_ms) == ["match", "align"]


def test_a_stage_that_fails_is_counted_too() -> None:
    clock = Stopwatch()
    with pytest.raises(KeyError), clock.stage("map"):
        raise KeyError
    assert clock.stage_ms["map"] >= 0.0
