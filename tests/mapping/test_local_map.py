from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vo.mapping.local_map import Keyframe, Map
from vo.types import Floats, Ints, Keypoints

CAPACITY, HEIGHT, WIDTH = 3, 4, 6


def _keypoints(count: int = 2) -> Keypoints:
    return Keypoints(
        np.zeros((count, 2), np.float32),
        np.zeros(count, np.int32),
        np.zeros(count, np.float32),
        np.zeros(count, np.float32),
        np.zeros((count, 32), np.uint8),
    )


def _keyframe(world: Map, number: int = 0) -> Keyframe:
    pose = np.eye(4)
    pose[0, 3] = number
    return world.add_keyframe(
        frame_index=10 * number,
        stamp_ns=1000 * number,
        segment=0,
        image=np.full((HEIGHT, WIDTH), number % 256, np.uint8),
        world_from_cam=pose,
        keypoints=_keypoints(),
        undistorted_xy=np.zeros((2, 2)),
        free=np.ones(2, dtype=bool),
    )


def _landmarks(world: Map, keyframe: Keyframe, count: int = 4) -> Ints:
    """New landmarks that the keyframe sees; their values tell their id."""
    first = int(world.id[-1]) + 1 if len(world) else 0
    values = np.arange(first, first + count, dtype=np.float64)
    ids = world.add_landmarks(
        np.column_stack([values, values, values]),
        np.tile(values[:, None].astype(np.uint8), (1, 32)),
        values.astype(np.int32),
        values.astype(np.float32),
        keyframe,
        np.column_stack([values, 100.0 * np.full(count, keyframe.id)]),
        keyframe,
    )
    _observe(keyframe, ids)
    return ids


def _observe(keyframe: Keyframe, ids: Ints) -> None:
    xy = np.column_stack([ids, 100.0 * np.full(len(ids), keyframe.id)]).astype(np.float64)
    keyframe.add_observations(ids, xy, xy, np.full(len(ids), np.nan), np.full(len(ids), 0.5))


def _map() -> Map:
    return Map(CAPACITY, HEIGHT, WIDTH)


def test_only_the_newest_keyframes_are_kept() -> None:
    world = _map()
    for number in range(7):
        _keyframe(world, number)
    assert [k.id for k in world.keyframes] == [4, 5, 6]
    assert [k.frame_index for k in world.keyframes] == [40, 50, 60]


def test_each_keyframe_keeps_its_own_image() -> None:
    world = _map()
    for number in range(8):
        _keyframe(world, number)
        for keyframe in world.keyframes:
            assert np.all(world.images[keyframe.slot] == keyframe.id)


def test_a_keyframe_does_not_share_its_pose_with_the_caller() -> None:
    world, pose = _map(), np.eye(4)
    keyframe = _keyframe(world)
    pose[0, 3] = 9.0
    assert keyframe.world_from_cam[0, 3] == 0.0


def test_ids_and_values_of_landmarks_survive_when_rows_move() -> None:
    world = _map()
    keyframe = _keyframe(world)
    ids = _landmarks(world, keyframe, 6)
    world.keep_landmarks(np.array([True, False, True, False, False, True]))
    more = _landmarks(world, keyframe, 2)
    assert ids.tolist() == [0, 1, 2, 3, 4, 5] and more.tolist() == [6, 7]
    assert world.id.tolist() == [0, 2, 5, 6, 7]
    np.testing.assert_array_equal(world.xyz[:, 0], world.id)
    np.testing.assert_array_equal(world.octave, world.id)
    np.testing.assert_array_equal(world.descriptor[:, 0], world.id)


def test_rows_of_ids_that_are_not_there_are_minus_one() -> None:
    world = _map()
    assert world.rows(np.array([0, 5])).tolist() == [-1, -1]
    _landmarks(world, _keyframe(world), 4)
    world.keep_landmarks(np.array([False, True, False, True]))
    assert world.rows(np.array([3, 0, 1, 2, 99])).tolist() == [1, -1, 0, -1, -1]
    assert world.rows(np.empty(0, np.int64)).tolist() == []


def test_observations_of_dropped_landmarks_are_forgotten() -> None:
    world = _map()
    first = _keyframe(world, 0)
    ids = _landmarks(world, first, 3)
    second = _keyframe(world, 1)
    _observe(second, ids[1:])
    world.keep_landmarks(np.array([True, False, True]))
    assert first.landmark.tolist() == [0, 2]
    assert second.landmark.tolist() == [2]
    np.testing.assert_array_equal(second.xy, [[2.0, 100.0]])
    for keyframe in (first, second):
        fields = (keyframe.xy, keyframe.image_xy, keyframe.disparity, keyframe.sigma_px)
        assert {len(f) for f in fields} == {len(keyframe.landmark)}


def test_landmarks_that_others_see_get_their_patch_from_the_oldest_of_them() -> None:
    world = _map()
    ids = _landmarks(world, _keyframe(world, 0), 4)
    _observe(_keyframe(world, 1), ids[:2])
    _observe(_keyframe(world, 2), ids[1:3])
    _keyframe(world, 3)  # drops keyframe 0, and with it the landmark that only it saw
    assert world.id.tolist() == [0, 1, 2]
    assert world.reference.tolist() == [1, 1, 2]
    for row, reference in enumerate(world.reference):
        seen = world.keyframes[reference - 1]
        at = np.flatnonzero(seen.landmark == world.id[row])
        np.testing.assert_array_equal(world.reference_xy[row], seen.image_xy[at[0]])


def test_references_lead_to_the_right_image() -> None:
    world = _map()
    for number in range(5):
        _landmarks(world, _keyframe(world, number), 2)
    slots = world.reference_slots()
    for row, reference in enumerate(world.reference):
        assert np.all(world.images[slots[row]] == reference)


def test_taking_a_reference_changes_only_chosen_landmarks_that_are_seen() -> None:
    world = _map()
    ids = _landmarks(world, _keyframe(world, 0), 4)
    second = _keyframe(world, 1)
    _observe(second, ids[1:])
    world.take_reference(second, np.array([True, True, False, True]))
    assert world.reference.tolist() == [0, 1, 0, 1]
    np.testing.assert_array_equal(world.reference_xy[[1, 3]], [[1.0, 100.0], [3.0, 100.0]])


def test_an_empty_map_goes_on_counting() -> None:
    world = _map()
    _landmarks(world, _keyframe(world, 0), 3)
    world.clear()
    assert len(world) == 0 and world.keyframes == []
    keyframe = _keyframe(world, 1)
    assert keyframe.id == 1
    ids = world.add_landmarks(
        np.zeros((1, 3)),
        np.zeros((1, 32), np.uint8),
        np.zeros(1, np.int32),
        np.zeros(1, np.float32),
        keyframe,
        np.zeros((1, 2)),
        keyframe,
    )
    assert ids.tolist() == [3]
    assert world.reference_slots().tolist() == [keyframe.slot]


def _check(world: Map) -> None:
    kept = [k.id for k in world.keyframes]
    assert len(kept) <= CAPACITY
    assert kept == sorted(kept)
    slots = [k.slot for k in world.keyframes]
    assert len(set(slots)) == len(slots) and set(slots) <= set(range(CAPACITY))
    assert np.all(np.diff(world.id) > 0)
    assert set(world.reference) <= set(kept)
    np.testing.assert_array_equal(world.xyz[:, 0], world.id)
    np.testing.assert_array_equal(world.reference_xy[:, 1], 100.0 * world.reference)
    for keyframe in world.keyframes:
        assert np.all(world.rows(keyframe.landmark) >= 0)
        assert len(np.unique(keyframe.landmark)) == len(keyframe.landmark)
        np.testing.assert_array_equal(keyframe.xy[:, 0], keyframe.landmark)
        assert np.all(world.images[keyframe.slot] == keyframe.frame_index // 10 % 256)
    if world.keyframes:
        assert len(world.reference_slots()) == len(world)


_operation = st.tuples(
    st.sampled_from(["keyframe", "grow", "see", "drop", "take", "clear"]), st.integers()
)


@settings(max_examples=100, deadline=None)
@given(st.lists(_operation, max_size=40))
def test_the_books_stay_right_whatever_happens(operations: list[tuple[str, int]]) -> None:
    world, frames, landmarks = _map(), 0, 0
    for name, seed in operations:
        rng = np.random.default_rng(abs(seed))
        if name == "keyframe":
            _keyframe(world, frames)
            frames += 1
        elif name == "clear" and seed % 3 == 0:
            world.clear()
        elif world.keyframes:
            keyframe = world.keyframes[int(rng.integers(len(world.keyframes)))]
            chosen = rng.random(len(world)) < 0.5
            if name == "grow":
                landmarks += _grow(world, keyframe, landmarks, int(rng.integers(5)))
            elif name == "see":
                _observe(keyframe, world.id[chosen & ~np.isin(world.id, keyframe.landmark)])
            elif name == "drop":
                world.keep_landmarks(chosen)
            elif name == "take":
                world.take_reference(keyframe, chosen)
        _check(world)


def _grow(world: Map, keyframe: Keyframe, first: int, count: int) -> int:
    values: Floats = np.arange(first, first + count, dtype=np.float64)
    ids = world.add_landmarks(
        np.column_stack([values] * 3),
        np.zeros((count, 32), np.uint8),
        np.zeros(count, np.int32),
        np.zeros(count, np.float32),
        keyframe,
        np.column_stack([values, np.full(count, 100.0 * keyframe.id)]),
        keyframe,
    )
    assert ids.tolist() == values.astype(int).tolist()
    _observe(keyframe, ids)
    return count


@pytest.mark.parametrize("capacity", [1, 2, 16])
def test_any_capacity_works(capacity: int) -> None:
    world = Map(capacity, HEIGHT, WIDTH)
    for number in range(20):
        _landmarks(world, _keyframe(world, number), 2)
    assert [k.id for k in world.keyframes] == list(range(20 - capacity, 20))
    assert len(world) == 2 * capacity
