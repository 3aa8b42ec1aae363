"""Old keyframes that get new poses, as after a loop closure, in recordings and exports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import exact_run
import numpy as np
import pytest
from rrd import STATIC, read_rrd

from vo.base.geometry.transforms import make_transform, so3_exp, transform_points
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats, KeyframePose, Rig, Trajectory
from vo.engine.trajectory.store import TrajectoryStore
from vo.outputs.recorders import entities, map_layer, settled_layer
from vo.outputs.recorders.keyframe_history import KeyframeHistory
from vo.outputs.recorders.reconstruction import Reconstruction
from vo.outputs.recorders.recorder import LoopClosures, Recorder
from vo.outputs.recorders.rerun_recorder import RerunRecorder

MOVE = make_transform(so3_exp(np.array([0.0, 0.2, 0.1])), np.array([1.0, -0.5, 2.0]))
BACK = make_transform(so3_exp(np.array([0.05, 0.0, -0.1])), np.array([-0.5, 0.2, 0.3]))
REPOSED = range(6)  # keyframes; frame 9 sees the map of the keyframes 6 to 9
CHUNK = 3


def pose_of(frame: int, world_from_cam0: Floats) -> KeyframePose:
    covariance = np.diag([1e-6, 1e-6, 1e-6, 1e-4, 2e-4, 3e-4])
    return KeyframePose(frame, frame * 100_000_000, 0, world_from_cam0, covariance)


def frames(
    store: TrajectoryStore, moves: Mapping[int, Floats]
) -> Iterator[tuple[Estimate, Snapshot]]:
    """The frames of `exact_run`; at some of them the first keyframes are moved in the world."""
    for frame in range(exact_run.FRAMES):
        for keyframe in exact_run.window(frame):
            store.store(keyframe, pose_of(keyframe, exact_run.pose(keyframe)))
        store.add(frame, frame * 100_000_000, 0, frame, exact_run.pose(frame))
        if frame in moves:
            for old in store.keyframes_by_id(REPOSED):
                world_from_cam0 = moves[frame] @ old.world_from_cam0
                store.store(old.frame_index, replace(old, world_from_cam0=world_from_cam0))
        estimate = replace(exact_run.estimate(frame), keyframes=store.take_moved())
        yield estimate, exact_run.snapshot(frame)


def record(recorder: Recorder, moves: Mapping[int, Floats]) -> TrajectoryStore:
    store = TrajectoryStore()
    recorder.begin("a name", Rig(exact_run.PINHOLE), None)
    for estimate, snapshot in frames(store, moves):
        recorder.record(estimate, lambda snapshot=snapshot: snapshot)
    recorder.finish(exact_run.smoothed(), store.trajectory())
    return store


def last_keyframe(landmark: int) -> int:
    seen = [
        f
        for f in range(exact_run.FRAMES)
        if landmark in exact_run.sightings(f, exact_run.PINHOLE).ids
    ]
    return max(seen, default=-1)


def moved_points(move: Floats) -> Floats:
    """All points (POINTS, 3), those last observed by a re-posed keyframe moved with it."""
    xyz = exact_run.points()
    is_moved = np.array([last_keyframe(k) in REPOSED for k in range(exact_run.POINTS)])
    xyz[is_moved] = transform_points(move, xyz[is_moved])
    return xyz


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settled_layer, "_KEYFRAMES_PER_CHUNK", CHUNK)
    monkeypatch.setattr(map_layer, "_FRAMES_BETWEEN_MAPS", 1)


def newest(rows: Mapping[str, list[tuple[int, Any]]], entity: str) -> list[Any]:
    """The newest row of each chunk of an entity."""
    chunks = sorted(name for name in rows if name.startswith(f"{entity}_chunks/"))
    return [[value for frame, value in rows[name] if frame != STATIC][-1] for name in chunks]


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("moves", [{9: MOVE}, {9: MOVE, 10: BACK}])
def test_the_viewer_gets_the_moved_path_and_landmarks(
    tmp_path: Path, moves: dict[int, Floats]
) -> None:
    path = tmp_path / "run.rrd"
    store = record(RerunRecorder(path, images="none"), moves)
    total = moves[9] if 10 not in moves else moves[10] @ moves[9]
    strips = read_rrd(path, "strips")
    positions = np.array([k.world_from_cam0[:3, 3] for k in store.keyframes()])
    for number, (strip,) in enumerate(newest(strips, entities.SMOOTHED_PATH)):
        first = max(CHUNK * number - 1, 0)  # connected to the chunk before
        expected = positions[first : CHUNK * (number + 1)]
        np.testing.assert_allclose(strip, expected, atol=1e-5)
    centres = np.concatenate(newest(read_rrd(path, "centers"), entities.COVARIANCE))
    np.testing.assert_allclose(centres, positions, atol=1e-5)
    chunks = newest(read_rrd(path, "positions"), entities.SETTLED_LANDMARKS)
    found = np.concatenate([np.reshape(chunk, (-1, 3)) for chunk in chunks])
    in_map = exact_run.landmarks(exact_run.FRAMES - 1, exact_run.PINHOLE).ids
    settled = [k for k in range(exact_run.POINTS) if last_keyframe(k) >= 0 and k not in in_map]
    expected = moved_points(total)[settled]
    assert len(found) == len(expected) > 50
    order, expected_order = np.lexsort(found.T), np.lexsort(expected.astype(np.float32).T)
    np.testing.assert_allclose(found[order], expected[expected_order], atol=1e-5)
    assert np.linalg.norm(expected - exact_run.points()[settled], axis=1).max() > 0.5


@pytest.mark.usefixtures("small_chunks")
def test_the_viewer_hides_the_pieces_logged_before(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    store = record(RerunRecorder(path, images="none"), {9: MOVE})
    for component, entity in (
        ("positions", entities.SETTLED_LANDMARKS),
        ("half_sizes", entities.COVARIANCE),
    ):
        rows = read_rrd(path, component)[entity]
        assert [value for frame, value in rows if frame == STATIC] == [[]]
    strips = read_rrd(path, "strips")
    final = [value for frame, value in strips[entities.SMOOTHED_PATH] if frame == STATIC][-1]
    np.testing.assert_allclose(final[0], store.trajectory().positions, atol=1e-5)
    for entity, rows in strips.items():
        if entity.startswith(f"{entities.SMOOTHED_PATH}_chunks/"):  # only the final path is shown
            assert [value for frame, value in rows if frame == STATIC][-1] == []


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize(("moves", "rows"), [({9: MOVE}, 1), ({9: MOVE, 11: BACK}, 2)])
def test_a_chunk_is_logged_again_only_if_it_moves(
    tmp_path: Path, moves: dict[int, Floats], rows: int
) -> None:
    path = tmp_path / "run.rrd"
    record(RerunRecorder(path, images="none"), moves)
    for component, entity in (("centers", entities.COVARIANCE), ("strips", entities.SMOOTHED_PATH)):
        found = [
            frame for frame, _ in read_rrd(path, component)[f"{entity}_chunks/0"] if frame != STATIC
        ]
        assert len(found) == rows


def test_without_reposing_there_are_no_chunks(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    record(RerunRecorder(path, images="none"), {})
    assert not [name for name in read_rrd(path, "strips") if "_chunks" in name]


def test_exported_points_move_with_the_last_keyframe_that_observes_them() -> None:
    store, reconstruction = TrajectoryStore(), Reconstruction()
    for estimate, snapshot in frames(store, {9: MOVE}):
        reconstruction.add(estimate, snapshot)
    (model,) = reconstruction.models(store.trajectory())
    poses = np.array([k.world_from_cam0 for k in store.keyframes()])
    np.testing.assert_allclose(model.world_from_image0, poses @ exact_run.CAM0_FROM_IMAGE0)
    expected = moved_points(MOVE)
    xyz = np.concatenate([points.xyz for points in model.points()])
    distance = np.linalg.norm(xyz[:, None] - expected, axis=2)
    assert distance.min(axis=1).max() < 1e-9
    assert (np.linalg.norm(xyz[:, None] - exact_run.points(), axis=2).min(axis=1) > 0.1).any()


def test_points_get_the_scale_of_their_keyframe() -> None:
    """A whole world with another unit at the end of the run."""
    reconstruction = Reconstruction()
    for frame in range(exact_run.FRAMES):
        reconstruction.add(exact_run.estimate(frame), exact_run.snapshot(frame))
    path, factor = exact_run.smoothed(), 3.0
    poses = np.stack([_grown(pose, factor) for pose in path.world_from_cam])
    scales = dict.fromkeys(range(exact_run.FRAMES), factor)
    closures = LoopClosures((), (), path, {}, scales)
    (before,) = reconstruction.models(path)
    (after,) = reconstruction.models(Trajectory(path.stamps_ns, poses), closures=closures)
    assert after.point_count == before.point_count > 100
    xyz, grown = (np.concatenate([p.xyz for p in m.points()]) for m in (before, after))
    np.testing.assert_allclose(grown, factor * xyz, atol=1e-9)


def test_points_that_left_the_map_get_the_scale_that_keyframes_get_later() -> None:
    """The unit of the world changes by the time of one frame, in keyframes and in landmarks."""
    factor, at = 3.0, 7
    reconstruction = Reconstruction()
    for frame in range(exact_run.FRAMES):
        estimate, snapshot = exact_run.estimate(frame), exact_run.snapshot(frame)
        assert snapshot.landmarks is not None
        if frame >= at:
            moved = range(frame + 1) if frame == at else exact_run.window(frame)
            keyframes = tuple(pose_of(k, _grown(exact_run.pose(k), factor)) for k in moved)
            keyframes = tuple(replace(k, scale=factor) for k in keyframes)
            estimate = replace(estimate, keyframes=keyframes)
            landmarks = replace(snapshot.landmarks, xyz=factor * snapshot.landmarks.xyz)
            snapshot = replace(snapshot, landmarks=landmarks)
        reconstruction.add(estimate, snapshot)
    (model,) = reconstruction.models()
    xyz = np.concatenate([points.xyz for points in model.points()])
    distance = np.linalg.norm(xyz[:, None] - factor * exact_run.points(), axis=2)
    assert len(xyz) > 100 and distance.min(axis=1).max() < 1e-9


def _grown(world_from_cam0: Floats, factor: float) -> Floats:
    grown = world_from_cam0.copy()
    grown[:3, 3] *= factor
    return grown


def test_a_keyframe_with_another_scale_moves_by_a_similarity() -> None:
    history = KeyframeHistory()
    for frame in range(12):
        history.update(exact_run.estimate(frame).keyframes, exact_run.snapshot(frame))
    old = pose_of(3, exact_run.pose(3))
    new = replace(old, world_from_cam0=MOVE @ old.world_from_cam0, scale=1.5)
    move = history.update([new], exact_run.snapshot(11)).moves[3]
    in_cam0 = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    moved = transform_points(move @ old.world_from_cam0, in_cam0)
    np.testing.assert_allclose(moved, transform_points(new.world_from_cam0, 1.5 * in_cam0))


def test_history_reports_moves_of_old_keyframes_only() -> None:
    history, store = KeyframeHistory(), TrajectoryStore()
    moves = [history.update(e.keyframes, s).moves for e, s in frames(store, {9: MOVE})]
    assert [frame for frame, found in enumerate(moves) if found] == [9]
    for frame in REPOSED:
        np.testing.assert_allclose(moves[9][frame], MOVE, atol=1e-12)
    assert [k.frame_index for k in history.window] == [8, 9, 10, 11]


def test_optimisation_of_a_map_that_is_replaced_is_not_reposing() -> None:
    history = KeyframeHistory()
    for frame in range(6):
        history.update(exact_run.estimate(frame).keyframes, exact_run.snapshot(frame))
    moved = [pose_of(k, MOVE @ exact_run.pose(k)) for k in (2, 3, 4, 5)]
    new_map = exact_run.snapshot(10)  # of the keyframes 7 to 10
    changes = history.update([*moved, pose_of(10, exact_run.pose(10))], new_map)
    assert not changes.moves
    newest = [pose_of(frame, exact_run.pose(frame)) for frame in (10, 11)]
    assert not history.update(newest, exact_run.snapshot(11)).moves
    changes = history.update([pose_of(3, exact_run.pose(3))], exact_run.snapshot(11))
    assert changes.moves.keys() == {3}
