"""Bags as the RealSense SDK and Viewer write them: topics by stream, frames `0`, `tf/0`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import layouts
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation, se3_exp
from vo.base.types import Floats
from vo.recordings.sources.registry import open_source

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(
    get_types_from_msg(
        "uint32 fps\nstring encoding\nbool is_recommended", "realsense_msgs/msg/StreamInfo"
    )
)
SENSOR = "/device_0/sensor_0"
RIGHT_FROM_LEFT = se3_exp(np.array([0.01, -0.02, 0.005, -0.12, 0.001, 0.002]))
GYRO_FROM_LEFT = se3_exp(np.array([0.0, 0.0, 0.1, 0.03, -0.007, 0.016]))
COLOUR_FROM_LEFT = se3_exp(np.array([0.0, 0.01, 0.0, 0.015, 0.0, 0.0]))


def of(name: str, *values: Any) -> Any:
    return STORE.types[name.replace("/", "/msg/")](*values)


def header(stamp_ns: int) -> Any:
    time = of("builtin_interfaces/Time", *divmod(stamp_ns, 10**9))
    return of("std_msgs/Header", 0, time, "0")


def camera_info(model: str, d: list[float]) -> Any:
    fx, fy, cx, cy = layouts.INTRINSICS
    k = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
    size, roi = (layouts.HEIGHT, layouts.WIDTH), of("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, 0)
    zeros = np.zeros(9), np.zeros(12)
    empty = of("std_msgs/Header", 0, of("builtin_interfaces/Time", 0, 0), "")
    return of("sensor_msgs/CameraInfo", empty, *size, model, np.array(d), k, *zeros, 0, 0, roi)


def transform(pose: Floats) -> Any:
    quat = quat_xyzw_from_rotation(pose[:3, :3])
    shift = of("geometry_msgs/Vector3", *pose[:3, 3].tolist())
    # The SDK negates both parts of some.
    return of("geometry_msgs/Transform", shift, of("geometry_msgs/Quaternion", *(-quat).tolist()))


def imu(stamp_ns: int, gyro: float, accel: float) -> Any:
    quat = of("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 0.0)
    rate, force = (of("geometry_msgs/Vector3", 0.0, v, 0.0) for v in (gyro, accel))
    none = np.zeros(9)
    return of("sensor_msgs/Imu", header(stamp_ns), quat, none, rate, none, force, none)


class Bag:
    """Static messages at 1 ns, frames at the time since the start of recording."""

    def __init__(self, path: Path) -> None:
        self.writer = Writer(path)
        self.connections: dict[str, Any] = {}

    def add(self, topic: str, message: Any, log_ns: int = 1) -> None:
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=STORE)
        data = STORE.serialize_ros1(message, kind)
        self.writer.write(self.connections[topic], log_ns, data)

    def stream(self, name: str, encoding: str, pose: Floats, info: Any) -> None:
        self.add(f"{name}/info", of("realsense_msgs/StreamInfo", 30, encoding, True))
        self.add(f"{name}/info/camera_info", info)
        self.add(f"{name}/tf/0", transform(pose))

    def image(self, name: str, number: int, encoding: str, data: bytes) -> None:
        stamp_ns = layouts.STAMPS_NS[number]
        step = len(data) // layouts.HEIGHT
        size = (layouts.HEIGHT, layouts.WIDTH)
        pixels = np.frombuffer(data, np.uint8)
        message = of("sensor_msgs/Image", header(stamp_ns), *size, encoding, 0, step, pixels)
        log_ns = stamp_ns - layouts.STAMPS_NS[0] + 50_000_000
        self.add(f"{name}/image/data", message, log_ns)
        text = of("diagnostic_msgs/KeyValue", "Frame Counter", str(number))
        self.add(f"{name}/image/metadata", text, log_ns)


def infrared(bag: Bag, model: str = "Brown Conrady", d: list[float] | None = None) -> None:
    left, right = (f"{SENSOR}/Infrared_{i}" for i in (1, 2))
    info = camera_info(model, d or [0.0] * 5)
    bag.stream(left, "8UC1", np.eye(4), info)
    bag.stream(right, "8UC1", RIGHT_FROM_LEFT, info)
    for i in range(layouts.COUNT):
        bag.image(left, i, "8UC1", layouts.image(i).tobytes())
        bag.image(right, i, "8UC1", layouts.image(i, right=True).tobytes())


def colour_and_depth(bag: Bag) -> None:
    colour, depth = "/device_0/sensor_1/Color_0", f"{SENSOR}/Depth_0"
    info = camera_info("Inverse Brown Conrady", [0.0] * 5)
    bag.stream(depth, "mono16", np.eye(4), info)
    bag.stream(colour, "rgb8", COLOUR_FROM_LEFT, info)
    for i in range(layouts.COUNT):
        bag.image(colour, i, "rgb8", np.repeat(layouts.image(i)[:, :, None], 3, 2).tobytes())
        depths = np.full((layouts.HEIGHT, layouts.WIDTH), 2000, np.uint16)
        bag.image(depth, i, "mono16", depths.tobytes())


def motion(bag: Bag) -> None:
    gyro, accel = (f"/device_0/sensor_2/{name}_0" for name in ("Gyro", "Accel"))
    bag.add(f"{gyro}/tf/0", transform(GYRO_FROM_LEFT))
    bag.add(f"{accel}/tf/0", transform(GYRO_FROM_LEFT))
    for i in range(200):
        stamp_ns = layouts.STAMPS_NS[0] + i * 5_000_000
        bag.add(f"{gyro}/imu/data", imu(stamp_ns, 0.1, 0.0), 1 + i * 5_000_000)
        if i % 2 == 0:
            bag.add(f"{accel}/imu/data", imu(stamp_ns, 0.0, -9.8), 1 + i * 5_000_000)


def poses(bag: Bag) -> None:
    """What a T265 adds: a pose of each frame in the same type as `tf/0`."""
    for i in range(10):
        pose = se3_exp(np.array([0, 0, 0, 0.1 * i, 0, 0]))
        bag.add("/device_0/sensor_0/Pose_0/pose/transform/data", transform(pose), 2 + i)


def write(path: Path, *parts: Callable[[Bag], None]) -> Path:
    bag = Bag(path)
    with bag.writer:
        bag.add("/file_version", of("std_msgs/UInt32", 2))
        for part in parts:
            part(bag)
    assert path.stat().st_size < 300_000
    return path


def test_infrared_pair(tmp_path: Path) -> None:
    source = open_source(write(tmp_path / "a.bag", infrared, colour_and_depth, poses))
    assert source.rig.cam0.distortion_model == "none"
    assert source.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(source.rig.cam1_from_cam0, RIGHT_FROM_LEFT, atol=1e-9)
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == layouts.STAMPS_NS
    assert all(np.array_equal(f.image0, layouts.image(f.index)) for f in frames)
    assert source.ground_truth is None


def test_inertial_sensor(tmp_path: Path) -> None:
    (imu,) = open_source(write(tmp_path / "a.bag", infrared, motion)).imus
    assert imu.cam0_from_imu is not None
    np.testing.assert_allclose(imu.cam0_from_imu, inverse(GYRO_FROM_LEFT), atol=1e-9)
    samples = imu.read()
    assert len(samples) > 150
    np.testing.assert_allclose(samples.gyro, [[0, 0.1, 0]] * len(samples))
    np.testing.assert_allclose(samples.accel, [[0, -9.8, 0]] * len(samples))


def test_depth_that_is_not_aligned_is_not_used(tmp_path: Path) -> None:
    source = open_source(write(tmp_path / "a.bag", colour_and_depth))
    assert not source.rig.has_depth
    assert len(list(source.frames())) == layouts.COUNT


@pytest.mark.parametrize(
    ("model", "d", "expected"),
    [
        ("Brown Conrady", [0.05, -0.01, 0.001, 0.002, 0.0], "radtan"),
        ("Inverse Brown Conrady", [0.0] * 5, "none"),
        ("Modified Brown Conrady", [0.0] * 5, "none"),
        ("Kannala Brandt4", [0.01, 0.02, 0.03, 0.04, 0.0], "equidistant"),
        ("None", [0.0] * 5, "none"),
    ],
)
def test_models_of_lenses(tmp_path: Path, model: str, d: list[float], expected: str) -> None:
    source = open_source(write(tmp_path / "a.bag", lambda bag: infrared(bag, model, d)))
    assert source.rig.cam0.distortion_model == expected
    assert source.rig.cam0.distortion == (tuple(d[: len(source.rig.cam0.distortion)]))
    assert source.rig.is_stereo


def test_model_that_is_not_read(tmp_path: Path) -> None:
    d = [0.05, -0.01, 0.001, 0.002, 0.0]
    path = write(tmp_path / "a.bag", lambda bag: infrared(bag, "Inverse Brown Conrady", d))
    with pytest.raises(CalibrationError, match="'Inverse Brown Conrady' is not.*calibration=FILE"):
        open_source(path)
