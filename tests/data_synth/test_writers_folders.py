"""Recordings in folders, read back by the odometry's own sources."""

from __future__ import annotations

import errno
import hashlib
import threading
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from recordings import BODY_FROM_CAM0, FISHEYE, FRAMES, RADTAN, make_recording, make_shots

from data_synth.recipe import Recipe
from data_synth.records import Recording
from data_synth.writers.registry import FORMATS, check, load_writer
from vo.errors import ConfigError
from vo.formats.calibration import read_calibration
from vo.formats.trajectory import read_euroc, read_kitti, read_tum
from vo.geometry.transforms import inverse, make_transform, rotation_from_quat_xyzw, so3_exp
from vo.sources.registry import open_source
from vo.types import Camera, Frame, Rig

IDEAL = Camera(48, 32, 40.0, 41.0, 23.3, 15.7)
RATIONAL = replace(IDEAL, distortion_model="radtan", distortion=tuple(np.arange(8) * 1e-3 / 7))
BESIDE = make_transform(np.eye(3), np.array([-0.11, 0.0, 0.0]))
PAIR = Rig(IDEAL, IDEAL, BESIDE)
NO_DROPS = ((), ())
IN_FOLDERS = ("euroc", "kitti", "tum", "folder")


def _suited(name: str) -> Recording:
    """A recording that a layout can hold, as hard as it can."""
    if name == "tum":
        return make_recording(stereo=False)
    recording = make_recording(drops=NO_DROPS) if name == "kitti" else make_recording()
    return replace(recording, rig=PAIR) if name == "kitti" else recording


def _write(name: str, path: Path, recording: Recording, codec: str = "png") -> Path:
    load_writer(name)(path, recording, make_shots(recording), codec)
    return path


def _frames(path: Path) -> list[Frame]:
    return list(open_source(path).frames())


def _check_images(frames: list[Frame], recording: Recording) -> None:
    """The frames hold, to the bit, the images of cam0's frames and their partners."""
    shots = [shot for shot in make_shots(recording) if shot.images[0] is not None]
    assert len(frames) == len(shots)
    for frame, shot in zip(frames, shots, strict=True):
        np.testing.assert_array_equal(frame.image0, shot.images[0])
        image1 = shot.images[1] if len(shot.images) == 2 else None
        assert (frame.image1 is None) == (image1 is None)
        if image1 is not None:
            np.testing.assert_array_equal(frame.image1, image1)


def _table(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", comments="#")


def _image(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


# What all layouts have in common


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_same_recording_gives_same_bytes(name: str, tmp_path: Path) -> None:
    digests = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        _write(name, folder, _suited(name))
        files = sorted(p for p in folder.rglob("*") if p.is_file())
        digests.append(
            {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
        )
    assert len(digests[0]) > 2 * FRAMES
    assert digests[0] == digests[1]


@pytest.mark.parametrize("name", IN_FOLDERS)
@pytest.mark.parametrize("codec", ["png", "jpeg"])
def test_is_known_by_its_content_and_opens(name: str, codec: str, tmp_path: Path) -> None:
    recording = _suited(name)
    source = open_source(_write(name, tmp_path / "a", recording, codec))
    assert source.format == name
    assert source.rig.is_stereo == recording.rig.is_stereo
    frames = list(source.frames())
    assert len(frames) == FRAMES - int(recording.dropped[0].sum())
    assert not source.skipped


@pytest.mark.parametrize("name", ["euroc", "kitti", "folder"])
def test_one_camera_without_depth_movers_or_imu(name: str, tmp_path: Path) -> None:
    recording = make_recording(IDEAL, stereo=False, inertial=False, depth=False, drops=((),))
    path = _write(name, tmp_path / "a", replace(recording, movers=()))
    source = open_source(path)
    assert source.format == name and not source.rig.is_stereo
    _check_images(list(source.frames()), recording)
    names = {p.name for p in path.rglob("*")}
    assert not names & {"depth", "movers.csv", "imu0", "cam1", "image_1", "left", "right"}


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_a_full_disk_is_an_os_error_and_leaves_no_thread(
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
        _write(name, tmp_path / "a", _suited(name))
    assert len(files) == 3
    assert not [t for t in threading.enumerate() if t.name.startswith("encode")]


# EuRoC


@pytest.fixture(scope="module")
def euroc(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    recording = make_recording()
    return _write("euroc", tmp_path_factory.mktemp("euroc") / "a", recording), recording


def test_euroc_frames_and_stamps_without_those_dropped(euroc: tuple[Path, Recording]) -> None:
    path, recording = euroc
    frames = _frames(path)
    _check_images(frames, recording)
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
    table = _table(file)
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


def test_euroc_inertial_sensor(euroc: tuple[Path, Recording]) -> None:
    path, recording = euroc
    imu = recording.imu
    assert imu is not None
    home = path / "mav0" / "imu0"
    stamps = np.loadtxt(home / "data.csv", delimiter=",", usecols=0, dtype=np.int64)
    np.testing.assert_array_equal(stamps, imu.stamps_ns)
    expected = np.hstack([imu.gyro, imu.accel])
    np.testing.assert_allclose(_table(home / "data.csv")[:, 1:], expected, rtol=1e-11)
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
    np.testing.assert_array_equal(_image(path / "depth" / f"{stamps[-1]}.tiff"), shots[-1].depth)
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
    path = _write(name, tmp_path / "a", recording)
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


# KITTI


def test_kitti_begins_at_time_0_and_the_identity(tmp_path: Path) -> None:
    recording = _suited("kitti")
    path = _write("kitti", tmp_path / "a", recording)
    first = ["1", "0", "0", "0", "0", "1", "0", "0", "0", "0", "1", "0"]
    assert (path / "poses.txt").read_text().splitlines()[0].split() == [
        f"{int(value):.12e}" for value in first
    ]
    source = open_source(path)
    stamps = recording.stamps_ns[0] - recording.stamps_ns[0][0]
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == stamps.tolist()
    _check_images(frames, recording)
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


def test_kitti_movers_and_depth_are_in_its_own_world(tmp_path: Path) -> None:
    recording = _suited("kitti")
    path = _write("kitti", tmp_path / "a", recording)
    world_from_cam, mover = recording.cam0_truth.world_from_cam, recording.movers[0]
    line = (path / "movers.csv").read_text().splitlines()[-1].split(",")
    assert int(line[0]) == recording.stamps_ns[0][-1] - recording.stamps_ns[0][0]
    expected = (inverse(world_from_cam[0]) @ mover.world_from_mover[-1])[:3, 3]
    np.testing.assert_allclose(np.array(line[2:5], dtype=float), expected, rtol=0, atol=1e-10)
    shots = list(make_shots(recording))
    np.testing.assert_array_equal(_image(path / "depth" / "000006.tiff"), shots[6].depth)


TURNED = make_transform(so3_exp(np.array([0.0, 1e-5, 0.0])), BESIDE[:3, 3])
RAISED = make_transform(np.eye(3), np.array([-0.11, 1e-5, 0.0]))
LEFT = make_transform(np.eye(3), np.array([0.11, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("rig", "reason"),
    [
        (Rig(RADTAN), "cam0 is distorted (radtan)"),
        (Rig(FISHEYE), "cam0 is distorted (equidistant)"),
        (Rig(IDEAL, RADTAN, BESIDE), "cam1 is distorted (radtan)"),
        (Rig(IDEAL, replace(IDEAL, fx=40.1), BESIDE), "cam1 is not equal to cam0"),
        (Rig(IDEAL, IDEAL, TURNED), "cam1 is turned or not straight to the right"),
        (Rig(IDEAL, IDEAL, RAISED), "shifts by -0.11, 1e-05, 0 m"),
        (Rig(IDEAL, IDEAL, LEFT), "shifts by 0.11, 0, 0 m"),
    ],
)
def test_kitti_refuses_what_is_not_rectified(rig: Rig, reason: str, tmp_path: Path) -> None:
    recording = replace(make_recording(stereo=rig.is_stereo, drops=NO_DROPS), rig=rig)
    with pytest.raises(ConfigError) as told:
        _write("kitti", tmp_path / "a", recording)
    with pytest.raises(ConfigError) as foretold:
        check(Recipe(format="kitti"), rig)
    assert str(told.value) == str(foretold.value)
    assert reason in str(told.value)
    assert "or format euroc, which can hold it" in str(told.value)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("drops", [((2,), ()), ((), (6,))])
def test_kitti_refuses_missing_frames(drops: tuple[tuple[int, ...], ...], tmp_path: Path) -> None:
    recording = replace(make_recording(drops=drops), rig=PAIR)
    with pytest.raises(ConfigError, match="cannot say which frames are missing; set effects.drops"):
        _write("kitti", tmp_path / "a", recording)
    recipe = Recipe.model_validate({"format": "kitti", "effects": {"drops": 0.5}})
    with pytest.raises(ConfigError, match="or choose format euroc"):
        check(recipe, PAIR)


# TUM


def test_tum_images_depth_and_truth(tmp_path: Path) -> None:
    recording = make_recording(stereo=False, drops=((0, 4),))
    path = _write("tum", tmp_path / "a", recording)
    source = open_source(path)
    frames = list(source.frames())
    _check_images(frames, recording)
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
    depth, shot = _image(path / rows[-1].split()[1]), list(make_shots(recording))[-1].depth
    assert shot is not None
    far = shot * 5000 > 65535.5
    assert 0.2 < far.mean() < 0.5 and depth.dtype == np.uint16
    assert (depth[far] == 0).all()
    np.testing.assert_allclose(depth[~far] / 5000, shot[~far], rtol=0, atol=1.001e-4)


def test_tum_accelerometer(tmp_path: Path) -> None:
    recording = make_recording(stereo=False)
    path = _write("tum", tmp_path / "a", recording)
    assert recording.imu is not None
    lines = (path / "accelerometer.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line[0] != "#"]
    assert [int(row[0].replace(".", "")) for row in rows] == recording.imu.stamps_ns.tolist()
    accel = np.array([row[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(accel, recording.imu.accel, rtol=1e-11)


def test_tum_refuses_a_pair_and_no_depth(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="make it mono .--mono., or choose format euroc"):
        _write("tum", tmp_path / "a", make_recording())
    with pytest.raises(ConfigError, match="holds one camera with depth, and this is a pair"):
        check(Recipe(format="tum"), PAIR)
    with pytest.raises(ConfigError, match="needs depth, and the recording has none; set depth"):
        _write("tum", tmp_path / "a", make_recording(stereo=False, depth=False))
    assert not (tmp_path / "a").exists()


# Plain folders


def test_folder_pairs_by_name_and_keeps_stamps_and_truth(tmp_path: Path) -> None:
    recording = make_recording()
    path = _write("folder", tmp_path / "a", recording)
    source = open_source(path)
    frames = list(source.frames())
    _check_images(frames, recording)
    kept = ~recording.dropped[0]
    assert [frame.stamp_ns for frame in frames] == recording.stamps_ns[0][kept].tolist()
    assert source.ground_truth is not None
    expected = recording.cam0_truth.world_from_cam[kept]
    np.testing.assert_allclose(source.ground_truth.world_from_cam, expected, rtol=0, atol=1e-8)
    assert not (path / "left" / "000003.png").exists()
    shots = list(make_shots(recording))
    np.testing.assert_array_equal(_image(path / "depth" / "000006.tiff"), shots[6].depth)


# The registry


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_a_writer(name: str) -> None:
    assert callable(load_writer(name))
    assert set(FORMATS) == set(Recipe.model_fields["format"].annotation.__args__)
    assert (FORMATS[name].suffix == ".mcap") == name.startswith("mcap")


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_raw_images_are_for_mcap_only(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} cannot hold images as raw; choose codec png or"):
        check(Recipe(format=name, codec="raw"), Rig(IDEAL))
    check(Recipe(format="mcap", codec="raw"), PAIR)


@pytest.mark.parametrize(
    ("name", "rig"),
    [("euroc", make_recording().rig), ("kitti", PAIR), ("tum", Rig(FISHEYE)), ("folder", PAIR)],
)
def test_what_fits_is_not_refused(name: str, rig: Rig) -> None:
    check(Recipe(format=name, codec="jpeg"), rig)
