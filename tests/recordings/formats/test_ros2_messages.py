"""Writing of ROS 2 messages, decoded by MCAP's official decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mcap.records import Schema as McapSchema
from mcap_ros2.decoder import DecoderFactory

from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw, so3_exp
from vo.base.types import Camera
from vo.recordings.formats import ros2
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    FrameTransform,
    ImageMessage,
    ImuMessage,
    Message,
    PoseMessage,
    TransformsMessage,
)

STAMP_NS = 1_403_636_579_763_555_584
POSE = make_transform(so3_exp(np.array([0.3, -2.0, 1.1])), np.array([1.5, -2.5, 1e-7]))


def decoded(message: Message) -> Any:
    """What someone reads who has nothing but the file."""
    schema = ros2.schema(type(message))
    stored = McapSchema(id=1, name=schema.name, encoding="ros2msg", data=schema.definition)
    decode = DecoderFactory().decoder_for("cdr", stored)
    assert decode is not None
    return decode(ros2.encode(message))


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def transform(position: Any, rotation: Any) -> Any:
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    place = np.array([position.x, position.y, position.z])
    return make_transform(rotation_from_quat_xyzw(quat), place)


@pytest.mark.parametrize(
    ("message", "name"),
    [
        (ImageMessage(STAMP_NS, "cam0", 1, 1, "mono8", b"\x07"), "sensor_msgs/msg/Image"),
        (
            CompressedImageMessage(STAMP_NS, "cam0", "png", b"\x89"),
            "sensor_msgs/msg/CompressedImage",
        ),
        (PoseMessage(STAMP_NS, "world", POSE), "geometry_msgs/msg/PoseStamped"),
        (ImuMessage(STAMP_NS, "body", np.zeros(3), np.zeros(3)), "sensor_msgs/msg/Imu"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_stamps_are_exact_to_the_nanosecond(message: Message, name: str) -> None:
    assert ros2.schema(type(message)).name == name
    assert stamp_ns(decoded(message)) == STAMP_NS


# CDR pads to the size of each number, so the length of a frame name shifts the fields after it.
@pytest.mark.parametrize("frame", ["", "c", "cam0", "camera"])
def test_images_are_exact_with_any_padding(frame: str) -> None:
    depth = np.array([[0.5, np.inf, 3.25], [1e-3, 80.0, 2.0]], dtype="<f4")
    image = decoded(ImageMessage(STAMP_NS, frame, 3, 2, "32FC1", depth.tobytes()))
    assert (image.width, image.height, image.step, image.encoding) == (3, 2, 12, "32FC1")
    assert (image.is_bigendian, image.header.frame_id) == (0, frame)
    np.testing.assert_array_equal(np.frombuffer(image.data, "<f4").reshape(2, 3), depth)


def test_inertial_samples_are_exact_and_have_no_orientation() -> None:
    gyro, accel = np.array([0.1, -1 / 3, 1e-9]), np.array([0.0, 9.81, -2.5e-5])
    sample = decoded(ImuMessage(STAMP_NS, "body", gyro, accel, 4e-6, 9e-4))
    w, a = sample.angular_velocity, sample.linear_acceleration
    assert [w.x, w.y, w.z, a.x, a.y, a.z] == [*gyro, *accel]
    assert sample.orientation_covariance[0] == -1.0
    assert list(sample.angular_velocity_covariance) == [4e-6, 0, 0, 0, 4e-6, 0, 0, 0, 4e-6]
    assert list(sample.linear_acceleration_covariance) == [9e-4, 0, 0, 0, 9e-4, 0, 0, 0, 9e-4]


def test_poses_and_transforms_are_exact() -> None:
    pose = decoded(PoseMessage(STAMP_NS, "world", POSE))
    assert pose.header.frame_id == "world"
    np.testing.assert_allclose(
        transform(pose.pose.position, pose.pose.orientation), POSE, atol=1e-14
    )
    pair = (FrameTransform("world", "body", POSE), FrameTransform("body", "cam0", np.eye(4)))
    first, second = decoded(TransformsMessage(STAMP_NS, pair)).transforms
    assert (first.header.frame_id, first.child_frame_id) == ("world", "body")
    assert (second.header.frame_id, second.child_frame_id) == ("body", "cam0")
    assert stamp_ns(first) == stamp_ns(second) == STAMP_NS
    read = transform(first.transform.translation, first.transform.rotation)
    np.testing.assert_allclose(read, POSE, atol=1e-14)


@pytest.mark.parametrize(
    ("model", "given", "name", "written"),
    [
        ("none", (), "plumb_bob", [0.0] * 5),
        ("radtan", (0.1, 0.2, 0.3, 0.4), "plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.0]),
        ("radtan", tuple(range(8)), "rational_polynomial", [float(i) for i in range(8)]),
        ("equidistant", (0.1, 0.2, 0.3, 0.4), "equidistant", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_distortion_models_have_the_names_of_ros(
    model: Any, given: tuple[float, ...], name: str, written: list[float]
) -> None:
    camera = Camera(640, 480, 400.0, 410.0, 320.5, 239.5, model, given)
    projection = np.arange(12.0).reshape(3, 4)
    message = CalibrationMessage(STAMP_NS, "cam1", camera, POSE[:3, :3], projection)
    read = decoded(message)
    assert (read.distortion_model, list(read.d)) == (name, written)
    assert (read.width, read.height, read.header.frame_id) == (640, 480, "cam1")
    assert list(read.k) == [400.0, 0.0, 320.5, 0.0, 410.0, 239.5, 0.0, 0.0, 1.0]
    assert list(read.r) == POSE[:3, :3].ravel().tolist()
    assert list(read.p) == [float(i) for i in range(12)]


def test_definition_contains_each_dependency_once() -> None:
    text = ros2.schema(TransformsMessage).definition.decode()
    parts = [line.removeprefix("MSG: ") for line in text.splitlines() if line.startswith("MSG: ")]
    assert sorted(parts) == [
        "builtin_interfaces/Time",
        "geometry_msgs/Quaternion",
        "geometry_msgs/Transform",
        "geometry_msgs/TransformStamped",
        "geometry_msgs/Vector3",
        "std_msgs/Header",
    ]
    assert text.splitlines().count("=" * 80) == len(parts)
