"""Recordings in folders, read back by the odometry's own sources."""

from __future__ import annotations

import errno
import hashlib
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folder_layouts import (
    BESIDE,
    IDEAL,
    IN_FOLDERS,
    check_images,
    read_pixels,
    suited,
    write_layout,
)
from recordings import BODY_FROM_CAM0, FRAMES, RADTAN, make_recording, make_shots

from vo.base.geometry.transforms import inverse
from vo.recordings.formats.trajectory import read_kitti, read_tum
from vo.recordings.sources.registry import open_source

# What all layouts have in common


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_same_recording_gives_same_bytes(name: str, tmp_path: Path) -> None:
    digests = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        write_layout(name, folder, suited(name))
        files = sorted(p for p in folder.rglob("*") if p.is_file())
        digests.append(
            {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
        )
    assert len(digests[0]) > 2 * FRAMES
    assert digests[0] == digests[1]


@pytest.mark.parametrize("name", IN_FOLDERS)
@pytest.mark.parametrize("codec", ["png", "jpeg"])
def test_layout_is_detected_and_opens(name: str, codec: str, tmp_path: Path) -> None:
    recording = suited(name)
    source = open_source(write_layout(name, tmp_path / "a", recording, codec))
    assert source.format == name
    assert source.rig.is_stereo == recording.rig.is_stereo
    frames = list(source.frames())
    assert len(frames) == FRAMES - int(recording.dropped[0].sum())
    assert not source.skipped


@pytest.mark.parametrize("name", ["euroc", "kitti", "folder"])
def test_recording_of_one_camera_without_depth_movers_or_imu(name: str, tmp_path: Path) -> None:
    recording = make_recording(IDEAL, stereo=False, inertial=False, depth=False, drops=((),))
    path = write_layout(name, tmp_path / "a", replace(recording, movers=()))
    source = open_source(path)
    assert source.format == name and not source.rig.is_stereo
    check_images(list(source.frames()), recording)
    names = {p.name for p in path.rglob("*")}
    assert not names & {"depth", "movers.csv", "imu0", "cam1", "image_1", "left", "right"}


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_full_disk_is_an_os_error_and_ends_all_threads(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files: list[Path] = []

    def write_bytes(path: Path, data: bytes) -> int:
        files.append(path)
        if len(files) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return len(data)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    with pytest.raises(OSError, match="No space left"):
        write_layout(name, tmp_path / "a", suited(name))
    assert len(files) == 3
    assert not [t for t in threading.enumerate() if t.name.startswith("encode")]


# KITTI


def test_kitti_starts_at_time_0_with_the_identity(tmp_path: Path) -> None:
    recording = suited("kitti")
    path = write_layout("kitti", tmp_path / "a", recording)
    first = ["1", "0", "0", "0", "0", "1", "0", "0", "0", "0", "1", "0"]
    assert (path / "poses.txt").read_text().splitlines()[0].split() == [
        f"{int(value):.12e}" for value in first
    ]
    source = open_source(path)
    stamps = recording.stamps_ns[0] - recording.stamps_ns[0][0]
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == stamps.tolist()
    check_images(frames, recording)
    world_from_cam = recording.cam0_truth.world_from_cam
    expected = inverse(world_from_cam[0]) @ world_from_cam
    assert source.ground_truth is not None
    for poses in (source.ground_truth, read_kitti(path / "poses.txt", stamps)):
        np.testing.assert_allclose(poses.world_from_cam, expected, rtol=0, atol=1e-11)
    assert (source.rig.cam0, source.rig.cam1) == (IDEAL, IDEAL)
    np.testing.assert_allclose(source.rig.cam1_from_cam0, BESIDE, rtol=0, atol=1e-12)
    lines = (path / "calib.txt").read_text().splitlines()
    assert [line[:3] for line in lines] == ["P0:", "P1:", "P2:", "P3:"]
    assert float(lines[1].split()[4]) == pytest.approx(-40.0 * 0.11, abs=1e-11)


def test_kitti_has_depth_and_movers_relative_to_the_first_camera_pose(tmp_path: Path) -> None:
    recording = suited("kitti")
    path = write_layout("kitti", tmp_path / "a", recording)
    world_from_cam, mover = recording.cam0_truth.world_from_cam, recording.movers[0]
    line = (path / "movers.csv").read_text().splitlines()[-1].split(",")
    assert int(line[0]) == recording.stamps_ns[0][-1] - recording.stamps_ns[0][0]
    expected = (inverse(world_from_cam[0]) @ mover.world_from_mover[-1])[:3, 3]
    np.testing.assert_allclose(np.array(line[2:5], dtype=float), expected, rtol=0, atol=1e-10)
    shots = list(make_shots(recording))
    np.testing.assert_array_equal(read_pixels(path / "depth" / "000006.tiff"), shots[6].depth)


# TUM


def test_tum_images_depth_and_truth_are_exact(tmp_path: Path) -> None:
    recording = make_recording(stereo=False, drops=((0, 4),))
    path = write_layout("tum", tmp_path / "a", recording)
    source = open_source(path)
    frames = list(source.frames())
    check_images(frames, recording)
    kept = recording.stamps_ns[0][~recording.dropped[0]].tolist()
    assert [frame.stamp_ns for frame in frames] == kept
    assert source.rig.cam0 == RADTAN
    truth = recording.body_truth
    assert source.ground_truth is not None
    np.testing.assert_array_equal(source.ground_truth.stamps_ns, truth.stamps_ns)
    expected = truth.world_from_body @ BODY_FROM_CAM0
    np.testing.assert_allclose(source.ground_truth.world_from_cam, expected, rtol=0, atol=1e-8)
    assert read_tum(path / "groundtruth.tum").stamps_ns.tolist() == kept
    rows = [r for r in (path / "depth.txt").read_text().splitlines() if r[0] != "#"]
    assert [row.split()[0] for row in rows] == [f"{s // 10**9}.{s % 10**9:09d}" for s in kept]
    depth, shot = read_pixels(path / rows[-1].split()[1]), list(make_shots(recording))[-1].depth
    assert shot is not None
    far = shot * 5000 > 65535.5
    assert 0.2 < far.mean() < 0.5 and depth.dtype == np.uint16
    assert (depth[far] == 0).all()
    np.testing.assert_allclose(depth[~far] / 5000, shot[~far], rtol=0, atol=1.001e-4)


def test_tum_accelerometer_samples_are_exact(tmp_path: Path) -> None:
    recording = make_recording(stereo=False)
    path = write_layout("tum", tmp_path / "a", recording)
    assert recording.imu is not None
    lines = (path / "accelerometer.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line[0] != "#"]
    assert [int(row[0].replace(".", "")) for row in rows] == recording.imu.stamps_ns.tolist()
    accel = np.array([row[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(accel, recording.imu.accel, rtol=1e-11)


# Plain folders


def test_folder_pairs_by_name_and_keeps_stamps_and_truth(tmp_path: Path) -> None:
    recording = make_recording()
    path = write_layout("folder", tmp_path / "a", recording)
    source = open_source(path)
    frames = list(source.frames())
    check_images(frames, recording)
    kept = ~recording.dropped[0]
    assert [frame.stamp_ns for frame in frames] == recording.stamps_ns[0][kept].tolist()
    assert source.ground_truth is not None
    expected = recording.cam0_truth.world_from_cam[kept]
    np.testing.assert_allclose(source.ground_truth.world_from_cam, expected, rtol=0, atol=1e-8)
    assert not (path / "left" / "000003.png").exists()
    shots = list(make_shots(recording))
    np.testing.assert_array_equal(read_pixels(path / "depth" / "000006.tiff"), shots[6].depth)
