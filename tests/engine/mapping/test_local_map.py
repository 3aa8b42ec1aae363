"""What the local map holds while keyframes and landmarks come and go."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vo.base.geometry.rectification import rectified_rig
from vo.base.types import Camera, Floats, Ints, Keypoints, Rig
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.mapping.keyframe import FrameId, Keyframe, without_disparity
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.lookup import rows_of

CAPACITY, HEIGHT, WIDTH = 3, 4, 6
RIG = rectified_rig(Rig(Camera(WIDTH, HEIGHT, 5.0, 5.0, 2.5, 1.5)))
ORB = DescriptorFormat(32, np.dtype(np.uint8))
FEATURES = 256  # of each keyframe; their values tell their row


def _keypoints(number: int) -> Keypoints:
    rows = np.arange(FEATURES)
    return Keypoints(
        np.column_stack([rows, np.full(FEATURES, 100.0 * number)]).astype(np.float32),
        rows.astype(np.int32),
        rows.astype(np.float32),
        np.zeros(FEATURES, np.float32),
        np.tile(rows[:, None].astype(np.uint8), (1, 32)),
    )


def _keyframe(local_map: LocalMap, number: int = 0) -> Keyframe:
    pose = np.eye(4)
    pose[0, 3] = number
    return local_map.add_keyframe(
        FrameId(index=10 * number, stamp_ns=1000 * number, segment=0),
        image=np.full((HEIGHT, WIDTH), number % 256, np.uint8),
        world_from_cam=pose,
        keypoints=_keypoints(number),
        free=np.ones(FEATURES, dtype=bool),
    )


def _landmarks(local_map: LocalMap, keyframe: Keyframe, count: int = 4) -> Ints:
    """New landmarks that the keyframe observes; their values tell their id."""
    first = int(local_map.id[-1]) + 1 if len(local_map) else 0
    rows = np.arange(first, first + count)
    xyz: Floats = np.column_stack([rows, rows, rows]).astype(np.float64)
    ids = local_map.add_landmarks(xyz, keyframe, rows, keyframe)
    _observe(keyframe, ids)
    return ids


def _observe(keyframe: Keyframe, ids: Ints) -> None:
    xy = np.column_stack([ids, 100.0 * np.full(len(ids), keyframe.id)]).astype(np.float64)
    keyframe.add_observations(without_disparity(ids, xy, xy, 0.5))


def _map(capacity: int = CAPACITY) -> LocalMap:
    return LocalMap(RIG, capacity, ORB)


def test_only_the_newest_keyframes_are_kept() -> None:
    local_map = _map()
    for number in range(7):
        _keyframe(local_map, number)
    assert [k.id for k in local_map.keyframes] == [4, 5, 6]
    assert [k.frame.index for k in local_map.keyframes] == [40, 50, 60]


def test_each_keyframe_keeps_its_own_image() -> None:
    local_map = _map()
    for number in range(8):
        _keyframe(local_map, number)
        for keyframe in local_map.keyframes:
            assert np.all(local_map.images[keyframe.slot] == keyframe.id)


def test_a_keyframe_does_not_share_its_pose_with_the_caller() -> None:
    local_map, pose = _map(), np.eye(4)
    keyframe = _keyframe(local_map)
    pose[0, 3] = 9.0
    assert keyframe.world_from_cam[0, 3] == 0.0


def test_ids_and_values_of_landmarks_survive_when_rows_move() -> None:
    local_map = _map()
    keyframe = _keyframe(local_map)
    ids = _landmarks(local_map, keyframe, 6)
    local_map.keep_landmarks(np.array([True, False, True, False, False, True]))
    more = _landmarks(local_map, keyframe, 2)
    assert ids.tolist() == [0, 1, 2, 3, 4, 5] and more.tolist() == [6, 7]
    assert local_map.id.tolist() == [0, 2, 5, 6, 7]
    np.testing.assert_array_equal(local_map.xyz[:, 0], local_map.id)
    np.testing.assert_array_equal(local_map.octave, local_map.id)
    np.testing.assert_array_equal(local_map.descriptor[:, 0], local_map.id)


def test_rows_of_ids_that_are_not_there_are_minus_one() -> None:
    local_map = _map()
    assert local_map.rows(np.array([0, 5])).tolist() == [-1, -1]
    _landmarks(local_map, _keyframe(local_map), 4)
    local_map.keep_landmarks(np.array([False, True, False, True]))
    assert local_map.rows(np.array([3, 0, 1, 2, 99])).tolist() == [1, -1, 0, -1, -1]
    assert local_map.rows(np.empty(0, np.int64)).tolist() == []


def test_observations_of_removed_landmarks_are_removed() -> None:
    local_map = _map()
    first = _keyframe(local_map, 0)
    ids = _landmarks(local_map, first, 3)
    second = _keyframe(local_map, 1)
    _observe(second, ids[1:])
    local_map.keep_landmarks(np.array([True, False, True]))
    assert first.landmark.tolist() == [0, 2]
    assert second.landmark.tolist() == [2]
    np.testing.assert_array_equal(second.xy, [[2.0, 100.0]])
    for keyframe in (first, second):
        fields = (keyframe.xy, keyframe.image_xy, keyframe.disparity, keyframe.sigma_px)
        assert {len(f) for f in fields} == {len(keyframe.landmark)}


def test_landmarks_that_others_observe_get_their_patch_from_the_oldest_of_them() -> None:
    local_map = _map()
    ids = _landmarks(local_map, _keyframe(local_map, 0), 4)
    _observe(_keyframe(local_map, 1), ids[:2])
    _observe(_keyframe(local_map, 2), ids[1:3])
    _keyframe(local_map, 3)  # keyframe 0 leaves, and with it the landmark that only it observes
    assert local_map.id.tolist() == [0, 1, 2]
    assert local_map.reference.tolist() == [1, 1, 2]
    for row, reference in enumerate(local_map.reference):
        seen = local_map.keyframes[reference - 1]
        at = np.flatnonzero(seen.landmark == local_map.id[row])
        np.testing.assert_array_equal(local_map.reference_xy[row], seen.image_xy[at[0]])


def test_references_lead_to_the_right_image() -> None:
    local_map = _map()
    for number in range(5):
        _landmarks(local_map, _keyframe(local_map, number), 2)
    slots = local_map.reference_slots()
    for row, reference in enumerate(local_map.reference):
        assert np.all(local_map.images[slots[row]] == reference)


def test_setting_a_reference_changes_only_chosen_landmarks_that_are_observed() -> None:
    local_map = _map()
    ids = _landmarks(local_map, _keyframe(local_map, 0), 4)
    second = _keyframe(local_map, 1)
    _observe(second, ids[1:])
    local_map.set_reference(second, observed=np.array([0, 2]), rows=np.array([1, 3]))
    assert local_map.reference.tolist() == [0, 1, 0, 1]
    np.testing.assert_array_equal(local_map.reference_xy[[1, 3]], [[1.0, 100.0], [3.0, 100.0]])


def test_ids_go_on_after_the_map_was_cleared() -> None:
    local_map = _map()
    _landmarks(local_map, _keyframe(local_map, 0), 3)
    local_map.clear()
    assert len(local_map) == 0 and local_map.keyframes == []
    keyframe = _keyframe(local_map, 1)
    assert keyframe.id == 1
    ids = local_map.add_landmarks(np.zeros((1, 3)), keyframe, np.zeros(1, np.int64), keyframe)
    assert ids.tolist() == [3]
    assert local_map.reference_slots().tolist() == [keyframe.slot]


def _check(local_map: LocalMap) -> None:
    kept = [k.id for k in local_map.keyframes]
    assert len(kept) <= CAPACITY
    assert kept == sorted(kept)
    slots = [k.slot for k in local_map.keyframes]
    assert len(set(slots)) == len(slots) and set(slots) <= set(range(CAPACITY))
    assert np.all(np.diff(local_map.id) > 0)
    assert set(local_map.reference) <= set(kept)
    np.testing.assert_array_equal(local_map.xyz[:, 0], local_map.id)
    np.testing.assert_array_equal(local_map.reference_xy[:, 1], 100.0 * local_map.reference)
    for keyframe in local_map.keyframes:
        assert np.all(local_map.rows(keyframe.landmark) >= 0)
        assert len(np.unique(keyframe.landmark)) == len(keyframe.landmark)
        np.testing.assert_array_equal(keyframe.xy[:, 0], keyframe.landmark)
        assert np.all(local_map.images[keyframe.slot] == keyframe.frame.index // 10 % 256)
    if local_map.keyframes:
        assert len(local_map.reference_slots()) == len(local_map)


_operation = st.tuples(
    st.sampled_from(["keyframe", "grow", "see", "drop", "take", "clear"]), st.integers()
)


@settings(max_examples=100, deadline=None)
@given(st.lists(_operation, max_size=40))
def test_map_stays_consistent_whatever_happens(operations: list[tuple[str, int]]) -> None:
    local_map, frames, landmarks = _map(), 0, 0
    for name, seed in operations:
        rng = np.random.default_rng(abs(seed))
        if name == "keyframe":
            _keyframe(local_map, frames)
            frames += 1
        elif name == "clear" and seed % 3 == 0:
            local_map.clear()
        elif local_map.keyframes:
            keyframe = local_map.keyframes[int(rng.integers(len(local_map.keyframes)))]
            chosen = rng.random(len(local_map)) < 0.5
            if name == "grow":
                landmarks += _grow(local_map, keyframe, landmarks, int(rng.integers(5)))
            elif name == "see":
                _observe(keyframe, local_map.id[chosen & ~np.isin(local_map.id, keyframe.landmark)])
            elif name == "drop":
                local_map.keep_landmarks(chosen)
            elif name == "take":
                rows = local_map.rows(keyframe.landmark)
                observed = np.flatnonzero(chosen[rows])
                local_map.set_reference(keyframe, observed, rows[observed])
        _check(local_map)


def _grow(local_map: LocalMap, keyframe: Keyframe, first: int, count: int) -> int:
    rows = np.arange(first, first + count)
    xyz: Floats = np.column_stack([rows] * 3).astype(np.float64)
    ids = local_map.add_landmarks(xyz, keyframe, rows, keyframe)
    assert ids.tolist() == rows.tolist()
    _observe(keyframe, ids)
    return count


@pytest.mark.parametrize("capacity", [1, 2, 16])
def test_any_capacity_works(capacity: int) -> None:
    local_map = _map(capacity)
    for number in range(20):
        _landmarks(local_map, _keyframe(local_map, number), 2)
    assert [k.id for k in local_map.keyframes] == list(range(20 - capacity, 20))
    assert len(local_map) == 2 * capacity


IDS = st.integers(0, 60)


@settings(deadline=None)
@given(st.sets(IDS), st.lists(IDS))
def test_every_id_is_found_where_it_is_and_no_other(known: set[int], wanted: list[int]) -> None:
    place = {landmark: row for row, landmark in enumerate(sorted(known))}
    rows = rows_of(np.array(wanted, np.int64), np.array(sorted(known), np.int64))
    assert rows.tolist() == [place.get(landmark, -1) for landmark in wanted]
