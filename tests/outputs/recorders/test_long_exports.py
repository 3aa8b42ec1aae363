"""PLY and COLMAP exports of long and of killed runs, and COLMAP's images."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import cv2
import exact_run
import numpy as np
import pytest

from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, KeyframePose, Landmarks, Rig, Sightings, State
from vo.outputs.recorders.colmap import ColmapRecorder, ImageFolder
from vo.outputs.recorders.map_spool import LANDMARK_ROW, MapSpool
from vo.outputs.recorders.ply import PlyRecorder
from vo.outputs.recorders.reconstruction import Reconstruction
from vo.outputs.recorders.recorder import Recorder

RIG = Rig(exact_run.PINHOLE)
PER_FRAME, OBSERVED, WINDOW = 60, 4, 8
SCATTER = np.random.default_rng(0).uniform(-2, 2, (7 * PER_FRAME, 3))


def test_a_killed_run_leaves_a_complete_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    monkeypatch.setattr("vo.outputs.recorders.ply._MIN_S", 0.0)
    monkeypatch.setattr("vo.outputs.recorders.ply._MAX_RATIO", 1e9)
    recorders: list[Recorder] = [ColmapRecorder(tmp_path), PlyRecorder(tmp_path / "map.ply")]
    for recorder in recorders:
        recorder.begin("a name", RIG, None)
        for frame in range(5):
            exact_run.record(recorder, frame)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    assert model.num_images() == 5
    for point in model.points3D.values():
        assert np.abs(exact_run.points() - point.xyz).max(axis=1).min() < 1e-9
        assert point.track.length() >= 2
    header = (tmp_path / "map.ply").read_bytes().partition(b"end_header\n")[0]
    assert f"element vertex {model.num_points3D()}\n".encode() in header
    assert not list(tmp_path.rglob("*.partial"))


def walk(frame: int) -> tuple[Estimate, Snapshot]:
    """A keyframe of a straight walk of any length; each landmark is seen in a few keyframes."""

    def seen(k: int) -> tuple[np.ndarray, np.ndarray]:
        first = max(k - OBSERVED + 1, 0)
        xyz = [SCATTER[PER_FRAME * (j % 7) :][:PER_FRAME] for j in range(first, k + 1)]
        offset = np.repeat(np.arange(first, k + 1), PER_FRAME)[:, None] * [0.0, 0.0, 0.1]
        return np.arange(first * PER_FRAME, (k + 1) * PER_FRAME), np.concatenate(xyz) + offset

    def pose(k: int) -> np.ndarray:
        world_from_cam = np.eye(4)
        world_from_cam[2, 3] = 0.1 * k - 8.0
        return world_from_cam

    def sightings(k: int) -> Sightings:
        ids, xyz = seen(k)
        local = xyz - pose(k)[:3, 3]
        camera = exact_run.PINHOLE
        xy = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        return Sightings(k, ids, xy)

    window = range(max(frame - WINDOW + 1, 0), frame + 1)
    pieces = [seen(k) for k in window]
    ids, rows = np.unique(np.concatenate([i for i, _ in pieces]), return_index=True)
    xyz = np.concatenate([x for _, x in pieces])[rows]
    view = replace(exact_run.view(0, exact_run.PINHOLE), cam0_from_image0=None)
    landmarks = Landmarks(ids, xyz, None, None, tuple(sightings(k) for k in window))
    keyframes = tuple(KeyframePose(k, k, 0, pose(k), np.eye(6)) for k in window)
    count = len(ids)
    estimate = Estimate(
        frame, frame, State.TRACKING, None, 0, pose(frame), True, count, count, count, keyframes
    )
    return estimate, Snapshot(view, landmarks)


def peak_bytes(frames: int) -> int:
    tracemalloc.start()
    reconstruction = Reconstruction()
    for frame in range(frames):
        reconstruction.add(*walk(frame))
    (model,) = reconstruction.models()
    assert sum(len(points.number) for points in model.points()) == model.point_count
    assert model.point_count > 0.9 * PER_FRAME * frames
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_hardly_grows_with_the_length_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vo.outputs.recorders.map_spool._TRACKS_AT_ONCE", 1000)
    short, long = peak_bytes(30), peak_bytes(130)
    observations = 100 * PER_FRAME * OBSERVED * 24  # bytes of ids and pixels alone
    assert long - short < 0.7 * observations


def test_a_spool_gives_back_what_was_stored_last(tmp_path: Path) -> None:
    spool = MapSpool(tmp_path)
    rows = np.zeros(4, LANDMARK_ROW)
    rows["keyframe"], rows["is_known"] = [1, 2, 3, 4], True
    spool.add_landmarks(np.array([0, 1, 7, 20_000]), rows)
    spool.add_landmarks(np.array([7]), rows[3:])
    found = spool.landmarks(np.array([0, 5, 7, 20_000, 900_000]))
    assert found["keyframe"].tolist() == [1, 0, 4, 4, 0]
    assert found["is_known"].tolist() == [True, False, True, True, False]
    for xy in ([[1.0, 2.0]], [[3.0, 4.0]]):
        spool.add_keyframe(Sightings(9, np.array([5]), np.array(xy)))
    ids, pixels = spool.observations(9)
    assert (ids.tolist(), pixels.tolist()) == ([5], [[3.0, 4.0]])
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    """It may lead to a file that is no part of the recording."""
    colour = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "secret.png"), colour)
    (tmp_path / "recording").mkdir()
    link, plain = (tmp_path / "recording" / name for name in ("link.png", "plain.png"))
    link.symlink_to(tmp_path / "secret.png")
    cv2.imwrite(str(plain), colour)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "link.png").symlink_to(plain)  # nor written to
    folder, grey = ImageFolder(tmp_path / "out"), np.zeros((48, 64), np.uint8)
    for number, path in enumerate((link, plain)):
        folder.add(number, path, grey, is_recorded=True)
    np.testing.assert_array_equal(cv2.imread(str(plain), cv2.IMREAD_UNCHANGED), colour)
    secret = (tmp_path / "secret.png").read_bytes()
    assert (tmp_path / "out" / "link.png").read_bytes() != secret
    assert (tmp_path / "out" / "plain.png").read_bytes() == secret  # the same picture
