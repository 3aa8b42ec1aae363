"""Decoding of messages written by official encoders, in each encoding."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vo.base.errors import CalibrationError, SourceError
from vo.base.geometry.transforms import quat_xyzw_from_rotation, se3_exp
from vo.base.types import Camera
from vo.recordings.formats.codecs import find_codec
from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import (
    HEAD_BYTES,
    CalibrationMessage,
    Codec,
    CompressedImageMessage,
    FrameTransform,
    ImageMessage,
    Message,
    PoseMessage,
    TransformsMessage,
)
from vo.recordings.formats.pixels import grey_pixels
from vo.recordings.formats.ros2 import ROS2

STAMP_NS = 1_403_636_579_763_555_584
POSE = se3_exp(np.array([0.3, -2.0, 1.1, 1.5, -2.5, 1e-7]))
GREY = np.random.default_rng(0).integers(0, 256, (5, 7), dtype=np.uint8)
LENS = Camera(640, 480, 400.0, 410.0, 320.5, 239.5, "radtan", (0.1, -0.2, 0.01, 0.02, 0.3))
PROJECTION = np.array([[390.0, 0, 318, -46.8], [0, 390, 242, 0], [0, 0, 1, 0]])
RECTIFIED = se3_exp(np.array([0.01, 0.02, -0.01, 0, 0, 0]))[:3, :3]

IMAGE = ImageMessage(STAMP_NS, "cam0", 7, 5, "mono8", GREY.tobytes())
COMPRESSED = CompressedImageMessage(STAMP_NS, "cam0", "png", b"\x89PNG and so on")
CALIBRATION = CalibrationMessage(STAMP_NS, "cam1", LENS, RECTIFIED, PROJECTION)
PLACE = PoseMessage(STAMP_NS, "world", POSE)
TRANSFORMS = TransformsMessage(STAMP_NS, (FrameTransform("body", "cam0", POSE),))

TF = "tf2_msgs/msg/TFMessage"
Encoded = tuple[Codec, bytes]


def _ours(message: Message, dialect: Any) -> Encoded:
    schema = dialect.schema(type(message))
    codec = find_codec(
        dialect.message_encoding, schema.name, dialect.schema_encoding, schema.definition
    )
    assert codec is not None
    return codec, dialect.encode(message)


def _as_ros1(message: Message) -> Encoded:
    """Encode a message with rosbags and the definitions of ROS 1."""
    schema = ROS2.schema(type(message))
    store = get_typestore(Stores.ROS1_NOETIC)
    name = schema.name
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    text, _ = store.generate_msgdef(name, ros_version=1)
    codec = find_codec("ros1", name.replace("/msg/", "/"), "ros1msg", text.encode())
    assert codec is not None
    if isinstance(message, CalibrationMessage):
        record = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(ROS2.encode(message), name)
        return codec, bytes(store.serialize_ros1(_camera_info_of_ros1(store, record), name))
    return codec, bytes(store.serialize_ros1(_with_ros1_header(store, message), name))


def _ros1_header(store: Any, frame: str) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](*divmod(STAMP_NS, 10**9))
    return store.types["std_msgs/msg/Header"](seq=7, stamp=time, frame_id=frame)


def _camera_info_of_ros1(store: Any, r: Any) -> Any:
    roi = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return store.types["sensor_msgs/msg/CameraInfo"](
        _ros1_header(store, "cam1"), r.height, r.width, r.distortion_model, r.d, r.k, r.r, r.p,
        0, 0, roi,
    )  # fmt: skip


def _with_ros1_header(store: Any, message: Message) -> Any:
    types = store.types
    quat = types["geometry_msgs/msg/Quaternion"](*quat_xyzw_from_rotation(POSE[:3, :3]))
    match message:
        case ImageMessage():
            return types["sensor_msgs/msg/Image"](
                _ros1_header(store, "cam0"), 5, 7, "mono8", 0, 7, GREY.ravel()
            )
        case CompressedImageMessage():
            data = np.frombuffer(message.data, np.uint8)
            return types["sensor_msgs/msg/CompressedImage"](
                _ros1_header(store, "cam0"), "png", data
            )
        case PoseMessage():
            point = types["geometry_msgs/msg/Point"](*POSE[:3, 3])
            pose = types["geometry_msgs/msg/Pose"](point, quat)
            return types["geometry_msgs/msg/PoseStamped"](_ros1_header(store, "/world"), pose)
    translation = types["geometry_msgs/msg/Vector3"](*POSE[:3, 3])
    transform = types["geometry_msgs/msg/Transform"](translation, quat)
    stamped = types["geometry_msgs/msg/TransformStamped"](
        _ros1_header(store, "/body"), "/cam0", transform
    )
    return types[TF]([stamped])


def _as_json(message: Message) -> Encoded:
    """Encode a message as JSON, as in Foxglove's documentation."""
    schema = FOXGLOVE.schema(type(message)).name
    codec = find_codec("json", schema, "jsonschema", b"{}")
    assert codec is not None
    return codec, json.dumps(_json_content(message)).encode()


def _json_content(message: Message) -> dict[str, Any]:
    seconds, nanoseconds = divmod(STAMP_NS, 10**9)
    x, y, z, w = quat_xyzw_from_rotation(POSE[:3, :3]).tolist()
    px, py, pz = POSE[:3, 3].tolist()
    position, rotation = {"x": px, "y": py, "z": pz}, {"x": x, "y": y, "z": z, "w": w}
    stamp = {"timestamp": {"sec": seconds, "nsec": nanoseconds}}
    match message:
        case ImageMessage():
            data = base64.b64encode(message.data).decode()
            size = {"width": 7, "height": 5, "encoding": "mono8", "step": 7}
            return {**stamp, "frame_id": "cam0", **size, "data": data}
        case CompressedImageMessage():
            data = base64.b64encode(message.data).decode()
            return {**stamp, "frame_id": "cam0", "format": "png", "data": data}
        case CalibrationMessage():
            camera, size = message.camera, {"width": 640, "height": 480}
            matrices = {
                "D": list(camera.distortion),
                "K": camera.matrix.ravel().tolist(),
                "R": RECTIFIED.ravel().tolist(),
                "P": PROJECTION.ravel().tolist(),
            }
            return {
                **stamp,
                "frame_id": "cam1",
                "distortion_model": "plumb_bob",
                **size,
                **matrices,
            }
        case PoseMessage():
            pose = {"position": position, "orientation": rotation}
            return {**stamp, "frame_id": "world", "pose": pose}
    frames = {"parent_frame_id": "body", "child_frame_id": "cam0"}
    return {"transforms": [{**stamp, **frames, "translation": position, "rotation": rotation}]}


def _without_definition(message: Message, text: bytes = b"") -> Encoded:
    """A message of ROS 2 as in bags before Iron, which contain no definitions."""
    codec = find_codec("cdr", ROS2.schema(type(message)).name, "", text)
    assert codec is not None
    return codec, ROS2.encode(message)


ENCODERS: dict[str, Callable[[Message], Encoded]] = {
    "ros1": _as_ros1,
    "ros2": lambda message: _ours(message, ROS2),
    "ros2 without definition": _without_definition,
    "ros2 without nested types": lambda message: _without_definition(
        message, b"std_msgs/Header header\n"
    ),
    "protobuf": lambda message: _ours(message, FOXGLOVE),
    "json": _as_json,
}


@pytest.fixture(params=ENCODERS)
def encode(request: pytest.FixtureRequest) -> Callable[[Message], Encoded]:
    return ENCODERS[request.param]


def test_raw_images(encode: Callable[[Message], Encoded]) -> None:
    codec, data = encode(IMAGE)
    read = codec.decode(data)
    assert codec.kind is ImageMessage
    assert isinstance(read, ImageMessage)
    assert (read.stamp_ns, read.frame) == (STAMP_NS, "cam0")
    assert np.array_equal(grey_pixels(read), GREY)


def test_compressed_images(encode: Callable[[Message], Encoded]) -> None:
    codec, data = encode(COMPRESSED)
    read = codec.decode(data)
    assert isinstance(read, CompressedImageMessage)
    assert (read.stamp_ns, read.frame, read.image_format) == (STAMP_NS, "cam0", "png")
    assert read.data == COMPRESSED.data


def test_calibrations(encode: Callable[[Message], Encoded]) -> None:
    codec, data = encode(CALIBRATION)
    read = codec.decode(data)
    assert isinstance(read, CalibrationMessage)
    assert (read.camera, read.frame) == (LENS, "cam1")
    np.testing.assert_array_equal(read.rectified_from_cam, RECTIFIED)
    np.testing.assert_array_equal(read.projection, PROJECTION)


def test_poses(encode: Callable[[Message], Encoded]) -> None:
    codec, data = encode(PLACE)
    read = codec.decode(data)
    assert isinstance(read, PoseMessage)
    assert (read.stamp_ns, read.frame, read.child) == (STAMP_NS, "world", "")
    np.testing.assert_allclose(read.pose, POSE, atol=1e-14)


def test_transforms(encode: Callable[[Message], Encoded]) -> None:
    codec, data = encode(TRANSFORMS)
    read = codec.decode(data)
    assert isinstance(read, TransformsMessage)
    assert read.stamp_ns == STAMP_NS
    (each,) = read.transforms
    assert (each.parent, each.child) == ("body", "cam0")
    np.testing.assert_allclose(each.parent_from_child, POSE, atol=1e-14)


@pytest.mark.parametrize("message", [IMAGE, COMPRESSED, CALIBRATION, PLACE])
def test_stamps_are_read_from_the_first_bytes(
    encode: Callable[[Message], Encoded], message: Message
) -> None:
    codec, data = encode(message)
    assert codec.peek_stamp_ns(data[:HEAD_BYTES]) in (STAMP_NS, None)
    if not data.startswith(b"{"):
        assert codec.peek_stamp_ns(data[:HEAD_BYTES]) == STAMP_NS


@pytest.mark.parametrize("message", [IMAGE, COMPRESSED, CALIBRATION, PLACE, TRANSFORMS])
def test_damaged_messages_raise_or_decode(
    encode: Callable[[Message], Encoded], message: Message
) -> None:
    codec, data = encode(message)
    rng = np.random.default_rng(8)
    for _ in range(60):
        wrong = bytearray(data[: int(rng.integers(0, len(data) + 1))])
        if wrong:
            wrong[int(rng.integers(len(wrong)))] ^= 1 << int(rng.integers(8))
        try:
            codec.peek_stamp_ns(bytes(wrong[:HEAD_BYTES]))
            codec.decode(bytes(wrong))
        except (SourceError, CalibrationError) as error:
            assert "\n" not in str(error)


def test_error_for_a_camera_that_was_never_calibrated() -> None:
    codec = find_codec("json", "foxglove.CameraCalibration", "", b"")
    assert codec is not None
    with pytest.raises(CalibrationError, match="'cam0' is empty.* `calibration=FILE`"):
        codec.decode(b'{"frame_id": "cam0", "width": 640, "height": 480}')


def test_intrinsics_are_adapted_to_cropping_and_binning() -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: Any = store.types
    schema = ROS2.schema(CalibrationMessage)
    codec = find_codec("cdr", schema.name, "ros2msg", schema.definition)
    assert codec is not None
    roi = types["sensor_msgs/msg/RegionOfInterest"](40, 20, 400, 600, False)
    record: Any = store.deserialize_cdr(ROS2.encode(CALIBRATION), schema.name)
    record.binning_x, record.binning_y, record.roi = 2, 4, roi
    read = codec.decode(bytes(store.serialize_cdr(record, schema.name)))
    assert isinstance(read, CalibrationMessage)
    camera = read.camera
    assert (camera.fx, camera.fy) == (200.0, 102.5)
    assert (camera.cx, camera.cy) == ((320.5 - 40) / 2, (239.5 - 20) / 4)
    assert (camera.width, camera.height) == (300, 100)


def test_no_codec_for_unsupported_types() -> None:
    assert find_codec("cdr", "sensor_msgs/msg/PointCloud2", "ros2msg", b"") is None
    assert find_codec("protobuf", "foxglove.Grid", "protobuf", b"") is None
    assert find_codec("flatbuffer", "foxglove.RawImage", "flatbuffer", b"") is None


def test_default_definition_replaces_an_unreadable_one() -> None:
    codec = find_codec("cdr", "sensor_msgs/msg/Image", "ros2msg", b"\xff not a definition")
    assert codec is not None
    read = codec.decode(ROS2.encode(IMAGE))
    assert isinstance(read, ImageMessage)
    assert np.array_equal(grey_pixels(read), GREY)
