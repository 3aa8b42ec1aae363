"""Recordings in the EuRoC layout, read back by the odometry's own source and as tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from folder_layouts import (
    IDEAL,
    RATIONAL,
    check_images,
    read_frames,
    read_pixels,
    read_table,
    write_layout,
)
from recordings import BODY_FROM_CAM0, FISHEYE, FRAMES, RADTAN, make_recording, make_shots

from data_synth.records import Recording
from vo.base.geometry.transforms import rotation_from_quat_xyzw
from vo.base.types import Camera
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.formats.trajectory import read_euroc, read_tum
from vo.recordings.sources.registry import open_source


@pytest.fixture(scope="module")
def euroc(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    recording = make_recording()
    return write_layout("euroc", tmp_path_factory.mktemp("euroc") / "a", recording), recording


def test_euroc_has_all_frames_and_stamps_but_the_dropped_ones(
    euroc: tuple[Path, Recording],
) -> None:
    path, recording = euroc
    frames = read_frames(path)
    check_images(frames, recording)
    kept = [recording.stamps_ns[camera][~recording.dropped[camera]] for camera in (0, 1)]
    assert [frame.stamp_ns for frame in frames] == kept[0].tolist()
    for camera in (0, 1):
        files = {p.name for p in (path / "mav0" / f"cam{camera}" / "data").iterdir()}
        assert files == {f"{stamp}.png" for stamp in kept[camera].tolist()}
    assert len(kept[0]) == FRAMES - 1 and len(kept[1]) == FRAMES - 2


def test_euroc_states_of_the_body_are_exact(euroc: tuple[Path, Recording]) -> None:
    path, recording = euroc
    truth = recording.body_truth
    file = path / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    body = read_euroc(file)
    np.testing.assert_array_equal(body.stamps_ns, truth.stamps_ns)
    np.testing.assert_allclose(body.world_from_cam, truth.world_from_body, rtol=0, atol=1e-10)
    table = read_table(file)
    for columns, expected in (
        (slice(8, 11), truth.velocity),
        (slice(11, 14), truth.gyro_bias),
        (slice(14, 17), truth.accel_bias),
    ):
        np.testing.assert_allclose(table[:, columns], expected, rtol=1e-11)
    camera = open_source(path).ground_truth
    assert camera is not None
    expected = truth.world_from_body @ BODY_FROM_CAM0
    np.testing.assert_allclose(camera.world_from_cam, expected, rtol=0, atol=1e-9)


def test_euroc_truth_of_cam0_is_at_its_frames(euroc: tuple[Path, Recording]) -> None:
    path, recording = euroc
    truth, kept = read_tum(path / "groundtruth.tum"), ~recording.dropped[0]
    np.testing.assert_array_equal(truth.stamps_ns, recording.stamps_ns[0][kept])
    expected = recording.cam0_truth.world_from_cam[kept]
    np.testing.assert_allclose(truth.world_from_cam, expected, rtol=0, atol=1e-8)


def test_euroc_inertial_samples_and_noise_are_exact(euroc: tuple[Path, Recording]) -> None:
    path, recording = euroc
    imu = recording.imu
    assert imu is not None
    home = path / "mav0" / "imu0"
    stamps = np.loadtxt(home / "data.csv", delimiter=",", usecols=0, dtype=np.int64)
    np.testing.assert_array_equal(stamps, imu.stamps_ns)
    expected = np.hstack([imu.gyro, imu.accel])
    np.testing.assert_allclose(read_table(home / "data.csv")[:, 1:], expected, rtol=1e-11)
    sensor = yaml.safe_load((home / "sensor.yaml").read_text())
    assert sensor["T_BS"]["data"] == np.eye(4).ravel().tolist()
    names = ("gyroscope_noise_density", "gyroscope_random_walk")
    names += ("accelerometer_noise_density", "accelerometer_random_walk", "rate_hz")
    assert [sensor[name] for name in names] == [1.7e-4, 1.9e-5, 2e-3, 3e-3, 200.0]


def test_euroc_depth_and_movers_are_at_the_frames_of_cam0(euroc: tuple[Path, Recording]) -> None:
    path, recording = euroc
    kept = np.flatnonzero(~recording.dropped[0])
    stamps = recording.stamps_ns[0][kept].tolist()
    assert {p.name for p in (path / "depth").iterdir()} == {f"{s}.tiff" for s in stamps}
    shots = list(make_shots(recording))
    np.testing.assert_array_equal(
        read_pixels(path / "depth" / f"{stamps[-1]}.tiff"), shots[-1].depth
    )
    lines = [line.split(",") for line in (path / "movers.csv").read_text().splitlines()[1:]]
    assert [(int(line[0]), line[1]) for line in lines] == [(s, "walker") for s in stamps]
    pose = recording.movers[0].world_from_mover[kept[-1]]
    position, quat_wxyz = np.split(np.array(lines[-1][2:], dtype=float), [3])
    rotation = rotation_from_quat_xyzw(np.roll(quat_wxyz, -1))
    np.testing.assert_allclose(position, pose[:3, 3], rtol=0, atol=1e-10)
    np.testing.assert_allclose(rotation, pose[:3, :3], rtol=0, atol=1e-10)


@pytest.mark.parametrize("camera", [RADTAN, RATIONAL, FISHEYE, IDEAL])
@pytest.mark.parametrize("name", ["euroc", "folder"])
def test_calibration_of_any_pair_comes_back(name: str, camera: Camera, tmp_path: Path) -> None:
    recording = make_recording(camera)
    other = replace(camera, fx=camera.fx + 1 / 3, cy=camera.cy - 1 / 7)
    recording = replace(recording, rig=replace(recording.rig, cam1=other))
    path = write_layout(name, tmp_path / "a", recording)
    for rig in (open_source(path).rig, read_calibration(path / "calibration.yaml").rig):
        for read, given in ((rig.cam0, camera), (rig.cam1, other)):
            assert read is not None
            assert (read.fx, read.fy, read.cx, read.cy) == (given.fx, given.fy, given.cx, given.cy)
            assert read.is_distorted == given.is_distorted
            if given.is_distorted:
                assert (read.distortion_model, read.distortion) == (
                    given.distortion_model,
                    given.distortion,
                )
        assert rig.cam1_from_cam0 is not None
        expected = recording.rig.cam1_from_cam0
        np.testing.assert_allclose(rig.cam1_from_cam0, expected, rtol=0, atol=1e-12)
