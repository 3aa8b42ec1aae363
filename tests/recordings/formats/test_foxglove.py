"""Writing of Foxglove's messages, decoded by MCAP's official decoder."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mcap.records import Schema as McapSchema
from mcap_protobuf.decoder import DecoderFactory

from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw, so3_exp
from vo.base.types import Camera
from vo.recordings.formats import foxglove
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
    """The message decoded with nothing but its stored schema."""
    schema = foxglove.schema(type(message))
    stored = McapSchema(id=1, name=schema.name, encoding="protobuf", data=schema.definition)
    decode = DecoderFactory().decoder_for("protobuf", stored)
    assert decode is not None
    return decode(foxglove.encode(message))


def stamp_ns(message: Any) -> int:
    return int(message.timestamp.seconds) * 10**9 + int(message.timestamp.nanos)


def transform(position: Any, rotation: Any) -> Any:
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    xyz = np.array([position.x, position.y, position.z])
    return make_transform(rotation_from_quat_xyzw(quat), xyz)


@pytest.mark.parametrize(
    ("message", "name"),
    [
        (ImageMessage(STAMP_NS, "cam0", 1, 1, "mono8", b"\x07"), "foxglove.RawImage"),
        (CompressedImageMessage(STAMP_NS, "cam0", "png", b"\x89"), "foxglove.CompressedImage"),
        (PoseMessage(STAMP_NS, "world", POSE), "foxglove.PoseInFrame"),
        (ImuMessage(STAMP_NS, "body", np.zeros(3), np.zeros(3)), "vo.Imu"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_stamps_are_exact_to_the_nanosecond(message: Message, name: str) -> None:
    assert foxglove.schema(type(message)).name == name
    assert stamp_ns(decoded(message)) == STAMP_NS


def test_depth_has_four_bytes_per_pixel() -> None:
    depth = np.array([[0.5, np.inf, 3.25], [1e-3, 80.0, 2.0]], dtype="<f4")
    image = decoded(ImageMessage(STAMP_NS, "cam0", 3, 2, "32FC1", depth.tobytes()))
    assert (image.width, image.height, image.step, image.encoding) == (3, 2, 12, "32FC1")
    np.testing.assert_array_equal(np.frombuffer(image.data, "<f4").reshape(2, 3), depth)


def test_inertial_samples_are_exact() -> None:
    gyro, accel = np.array([0.1, -1 / 3, 1e-9]), np.array([0.0, 9.81, -2.5e-5])
    sample = decoded(ImuMessage(STAMP_NS, "body", gyro, accel))
    w, a = sample.angular_velocity, sample.linear_acceleration
    assert [w.x, w.y, w.z, a.x, a.y, a.z] == [*gyro, *accel]
    assert sample.frame_id == "body"


def test_poses_and_transforms_are_exact() -> None:
    pose = decoded(PoseMessage(STAMP_NS, "world", POSE))
    assert pose.frame_id == "world"
    np.testing.assert_allclose(
        transform(pose.pose.position, pose.pose.orientation), POSE, atol=1e-14
    )
    pair = (FrameTransform("world", "body", POSE), FrameTransform("body", "cam0", np.eye(4)))
    first, second = decoded(TransformsMessage(STAMP_NS, pair)).transforms
    assert (first.parent_frame_id, first.child_frame_id) == ("world", "body")
    assert (second.parent_frame_id, second.child_frame_id) == ("body", "cam0")
    assert stamp_ns(first) == stamp_ns(second) == STAMP_NS
    np.testing.assert_allclose(transform(first.translation, first.rotation), POSE, atol=1e-14)


@pytest.mark.parametrize(
    ("model", "given", "name", "written"),
    [
        ("none", (), "plumb_bob", [0.0] * 5),
        ("radtan", (0.1, 0.2, 0.3, 0.4), "plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.0]),
        ("radtan", (0.1, 0.2, 0.3, 0.4, 0.5), "plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.5]),
        ("radtan", tuple(range(8)), "rational_polynomial", [float(i) for i in range(8)]),
        ("equidistant", (0.1, 0.2, 0.3, 0.4), "kannala_brandt", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_distortion_models_have_the_names_of_foxglove(
    model: Any, given: tuple[float, ...], name: str, written: list[float]
) -> None:
    camera = Camera(640, 480, 400.0, 410.0, 320.5, 239.5, model, given)
    projection = np.arange(12.0).reshape(3, 4)
    message = CalibrationMessage(STAMP_NS, "cam1", camera, POSE[:3, :3], projection)
    read = decoded(message)
    assert (read.distortion_model, list(read.D)) == (name, written)
    assert (read.width, read.height, read.frame_id) == (640, 480, "cam1")
    assert list(read.K) == [400.0, 0.0, 320.5, 0.0, 410.0, 239.5, 0.0, 0.0, 1.0]
    assert list(read.R) == POSE[:3, :3].ravel().tolist()
    assert list(read.P) == [float(i) for i in range(12)]
