"""Velocity of the camera during the readout of a frame, and whole runs with a rolling shutter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inertial_flight import IMU_FROM_CAM, NOISE, START_NS, sensor, world_from_cam

from data_synth.recipe import load_recipe
from data_synth.sequence import make_sequence
from vo.base.config import load_config
from vo.base.errors import CalibrationError
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse, se3_log
from vo.base.types import Camera, Floats, Keypoints, Rig
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.geometry.rolling_shutter import Velocity
from vo.engine.inertial.prediction import InertialPredictor
from vo.engine.inertial.samples import SampleReader
from vo.engine.mapping.keyframe import FrameId
from vo.engine.mapping.local_map import LocalMap
from vo.engine.tracking.inertial_motion import GyroMotion, InertialMotion
from vo.engine.tracking.motion_model import ConstantVelocity, MotionModel
from vo.engine.tracking.rolling_shutter import RollingShutter
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

CAMERA = Camera(640, 480, 450.0, 455.0, 320.0, 240.0, readout_s=0.03)
STAMPS = START_NS + 1_000_000_000 + np.arange(40) * 50_000_000
KEYFRAME = 30  # the frame that becomes one


def _twist(stamp_ns: int) -> Floats:
    """True velocity of the camera at a time."""
    before, after = world_from_cam(np.array([stamp_ns - 500_000, stamp_ns + 500_000]))
    return se3_log(inverse(before) @ after) / 1e-3


def _error(found: Velocity | None, stamp_ns: int) -> tuple[float, float]:
    """Of the angular and the linear velocity, rad/s and m/s."""
    assert found is not None
    off = np.concatenate(found) - _twist(stamp_ns)
    return float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:]))


def _with_gyro() -> MotionModel:
    reader = SampleReader(sensor(noise=1.0))
    predictor = InertialPredictor(reader, NOISE, IMU_FROM_CAM)
    return InertialMotion(GyroMotion(reader, IMU_FROM_CAM), predictor)


def _add_keyframe(local_map: LocalMap, stamp_ns: int, pose: Floats) -> None:
    empty = np.empty((0, 2), np.float32)
    none = np.empty(0, np.float32)
    keypoints = Keypoints(empty, none.astype(np.int32), none, none, np.empty((0, 32), np.uint8))
    image = np.zeros((480, 640), np.uint8)
    frame = FrameId(0, stamp_ns, 0)
    local_map.add_keyframe(frame, image, pose, keypoints, np.empty(0, bool))


def _followed(camera: Camera, motion: MotionModel) -> tuple[RollingShutter, LocalMap]:
    """All frames but the last, after the first of which a map was made."""
    rig = rectified_rig(Rig(camera))
    local_map = LocalMap(rig, 4, DescriptorFormat(32, np.dtype(np.uint8)))
    shutter = RollingShutter(local_map, motion)
    poses = world_from_cam(STAMPS)
    shutter.restart(int(STAMPS[0]))
    motion.restart(int(STAMPS[0]), poses[0])
    _add_keyframe(local_map, int(STAMPS[0]), poses[0])
    for number, (stamp, pose) in enumerate(zip(STAMPS[1:-1].tolist(), poses[1:-1], strict=True), 1):
        shutter.update(stamp, pose)
        motion.update(stamp, pose)
        if number == KEYFRAME:
            _add_keyframe(local_map, stamp, pose)
    return shutter, local_map


def test_velocity_goes_on_changing_as_before() -> None:
    shutter, _ = _followed(CAMERA, ConstantVelocity())
    last, (before, pose) = int(STAMPS[-1]), world_from_cam(STAMPS[-2:])
    angular, linear = _error(shutter.velocity(last, pose), last)
    mean = se3_log(inverse(before) @ pose) / 0.05 - _twist(last)
    assert angular < 0.2 * np.linalg.norm(mean[:3])
    assert linear < 0.2 * np.linalg.norm(mean[3:])


def test_a_gyroscope_that_images_confirm_gives_the_rotation() -> None:
    shutter, _ = _followed(CAMERA, _with_gyro())
    last, pose = int(STAMPS[-1]), world_from_cam(STAMPS[-1:])[0]
    turned = pose.copy()
    turned[:3, :3] = turned[:3, :3] @ world_from_cam(STAMPS[:1])[0, :3, :3]  # a wrong pose
    assert _error(shutter.velocity(last, pose), last)[0] < 0.01
    assert _error(shutter.velocity(last, turned), last)[0] < 0.01


def test_keyframes_are_corrected_with_the_motion_after_them() -> None:
    _, local_map = _followed(CAMERA, ConstantVelocity())
    first, second = local_map.keyframes
    # The first frame knows the mean velocity until the next frame only.
    angular, linear = _error(second.velocity, int(STAMPS[KEYFRAME]))
    assert angular < 0.01 and linear < 0.01
    assert _error(first.velocity, int(STAMPS[0]))[0] < 0.2


def test_nothing_is_corrected_with_a_global_shutter() -> None:
    shutter, local_map = _followed(replace(CAMERA, readout_s=0.0), ConstantVelocity())
    assert shutter.velocity(int(STAMPS[-1]), world_from_cam(STAMPS[-1:])[0]) is None
    assert [keyframe.velocity for keyframe in local_map.keyframes] == [None, None]


def test_velocity_is_unknown_after_a_long_step_and_before_any() -> None:
    shutter, _ = _followed(CAMERA, ConstantVelocity())
    pose = world_from_cam(STAMPS[-1:])[0]
    assert shutter.velocity(int(STAMPS[-1]) + 1_000_000_000, pose) is None
    shutter.restart(int(STAMPS[-1]))
    assert shutter.velocity(int(STAMPS[-1]), pose) is None


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of 4 s through a room by hand, whose rows are read within 30 ms."""
    folder = tmp_path_factory.mktemp("rolling") / "walk"
    effects = ["effects.rolling_shutter=1.5", "effects.exposure=0", "effects.noise=0"]
    settings = ["motion=handheld", "seconds=4", "fps=15", "scale=0.5", "speed=1.5", *effects]
    make_sequence(folder, load_recipe("demo", settings))
    return folder


def _ate_m(walk: Path, output: Path, *settings: str) -> float:
    """Root mean square error of all positions, aligned without scale."""
    run(walk, output, config=load_config(overrides=["inertial.enabled=false", *settings]))
    found, truth = read_tum(output / "trajectory.tum"), read_tum(walk / "groundtruth.tum")
    assert len(found) == len(truth) == 60
    fit = umeyama(found.positions, truth.positions, with_scale=False)
    off = fit.transform_points(found.positions) - truth.positions
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def test_path_of_a_rolling_shutter_has_a_small_part_of_its_error(
    walk: Path, tmp_path: Path
) -> None:
    usual = _ate_m(walk, tmp_path / "usual", "camera.readout_s=0")
    corrected = _ate_m(walk, tmp_path / "corrected")  # its calibration has the readout time
    assert usual > 0.012
    assert corrected < 0.35 * usual


def test_readout_longer_than_a_frame_is_refused(walk: Path, tmp_path: Path) -> None:
    config = load_config(overrides=["camera.readout_s=0.07"])
    with pytest.raises(CalibrationError, match=r"readout_s is 0.07 s, but frames are 0.0667"):
        run(walk, tmp_path / "out", config=config)
