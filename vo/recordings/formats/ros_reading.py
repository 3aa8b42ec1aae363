"""Reader of messages of ROS 1 and ROS 2, by the definitions stored with them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg
from rosbags.typesys import get_typestore as load_store
from rosbags.typesys.store import Typestore

from vo.base.errors import SourceError
from vo.base.types import Floats
from vo.recordings.formats.camera_messages import RawCalibration, calibration_message
from vo.recordings.formats.messages import (
    BareTransformMessage,
    CalibrationMessage,
    Codec,
    CompressedImageMessage,
    CompressedVideoMessage,
    FrameTransform,
    ImageMessage,
    ImuMessage,
    PathMessage,
    PoseMessage,
    PositionFixMessage,
    ReadMessage,
    TransformsMessage,
    TwistMessage,
    encoded_message,
    rigid_transform,
    vector3,
)

_NS_PER_S = 1_000_000_000
_MAX_DEFINITION_BYTES = 100_000
_MAX_FIELDS = 1000  # the largest of ROS's own has 60
_OTHER_DEFINITIONS = {
    "foxglove_msgs/msg/CompressedImage": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
    "foxglove_msgs/msg/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": (
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\n"
        "uint8 flags\nbool is_bigendian\nuint8[] data"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "tf/msg/tfMessage": "geometry_msgs/TransformStamped[] transforms",
}
"""Definitions of supported types that rosbags does not have in every distribution."""


def ros2_codec(schema: str, schema_encoding: str, definition: bytes) -> Codec | None:
    """The codec of a message type in CDR; None for unsupported types.

    `definition`: text of the definition; that of ROS 2 Humble is used if it is empty, as in bags
    before ROS 2 Iron, or cannot be read.
    """
    name = _full_name(schema)
    if name not in _CONVERTERS:
        return None
    store = _store(name, schema_encoding, definition, Stores.ROS2_HUMBLE)
    return _codec(name, lambda data: store.deserialize_cdr(data, name), _peek_cdr)


def ros1_codec(schema: str, definition: bytes) -> Codec | None:
    """As `ros2_codec` for a message type of ROS 1; the default definitions are Noetic's."""
    name = _full_name(schema)
    if name not in _CONVERTERS:
        return None
    store = _store(name, "ros1msg", definition, Stores.ROS1_NOETIC)
    return _codec(name, lambda data: store.deserialize_ros1(data, name), _peek_ros1)


def _codec(name: str, parse: Callable[[bytes], Any], peek: Callable[[bytes], int]) -> Codec:
    kind, convert = _CONVERTERS[name]

    def decode(data: bytes) -> ReadMessage:
        try:
            record = parse(data)
        # The exception of rosbags' generated code depends on where the bytes become invalid.
        except Exception as error:
            raise SourceError(
                f"{name} cannot be decoded: {error or type(error).__name__}"
            ) from error
        try:
            return convert(record)
        except (AttributeError, TypeError, ValueError) as error:
            raise SourceError(f"the definition of {name} is not supported: {error}") from error

    # A TFMessage has no stamp; each of its transforms has one.
    has_stamp = kind not in (TransformsMessage, BareTransformMessage)
    return Codec(kind, decode, peek if has_stamp else lambda _: None)


def _full_name(schema: str) -> str:
    package, _, name = schema.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{name}"


@lru_cache(maxsize=64)
def _store(name: str, encoding: str, definition: bytes, fallback: Stores) -> Typestore:
    try:
        if len(definition) > _MAX_DEFINITION_BYTES:
            raise ValueError(f"a definition of {len(definition)} bytes")
        text = definition.decode()
        is_idl = encoding == "ros2idl"
        types = get_types_from_idl(text) if is_idl else get_types_from_msg(text, name)
        store = load_store(Stores.EMPTY)
        store.register(types)
        # All supported types have fields; an empty text is parsed to a type without any.
        if types[name][1] and _count_fields(store, name, set()) <= _MAX_FIELDS:
            return store
    # The parser of rosbags is recursive, and raises errors of its own and of others.
    except (TypesysError, LookupError, ValueError, ArithmeticError, RecursionError):
        pass
    store = load_store(fallback)
    if name not in store.fielddefs and name in _OTHER_DEFINITIONS:
        store.register(get_types_from_msg(_OTHER_DEFINITIONS[name], name))
    return store


def _count_fields(store: Typestore, name: str, outer: set[str]) -> int:
    """Fields of a type, those of fixed arrays counted again and again: rosbags unrolls its code.

    Raises:
        ValueError: the type contains itself.
        KeyError: a type in it is not defined.
    """
    if name in outer:
        raise ValueError(f"{name} contains itself")
    count = 0
    for _, description in store.fielddefs[name][1]:
        kind: Any = description[0]
        content: Any = description[1]
        times = 1
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            times = content[1] if kind is Nodetype.ARRAY else 1
            kind, content = content[0]
        if kind is Nodetype.NAME:
            count += times * _count_fields(store, str(content), outer | {name})
        else:
            is_text = "string" in str(content)
            count += times if is_text else 1  # an array of numbers is read as a whole
        if count > _MAX_FIELDS:
            break
    return count


def _peek_cdr(head: bytes) -> int:
    """The stamp at the beginning of the header, after four bytes with the byte order."""
    if len(head) < 12:
        raise SourceError(f"message of {len(head)} bytes is cut off")
    seconds, nanoseconds = struct.unpack_from("<iI" if head[1] & 1 else ">iI", head, 4)
    return int(seconds) * _NS_PER_S + int(nanoseconds)


def _peek_ros1(head: bytes) -> int:
    """The stamp in the header, after the sequence number."""
    if len(head) < 12:
        raise SourceError(f"message of {len(head)} bytes is cut off")
    _, seconds, nanoseconds = struct.unpack_from("<III", head)
    return int(seconds) * _NS_PER_S + int(nanoseconds)


def _stamp_ns(time: Any) -> int:
    return int(time.sec) * _NS_PER_S + int(time.nanosec)


def _image(record: Any) -> ImageMessage:
    return ImageMessage(
        stamp_ns=_stamp_ns(record.header.stamp),
        frame=record.header.frame_id,
        width=record.width,
        height=record.height,
        pixel_format=record.encoding,
        data=record.data.data,
        step=record.step,
        big_endian=bool(record.is_bigendian),
    )


def _compressed(record: Any) -> CompressedImageMessage | CompressedVideoMessage:
    stamp_ns, frame = _stamp_ns(record.header.stamp), record.header.frame_id
    return encoded_message(stamp_ns, frame, record.format, record.data.tobytes())


def _ffmpeg_packet(record: Any) -> CompressedVideoMessage:
    stamp_ns, frame = _stamp_ns(record.header.stamp), record.header.frame_id
    return CompressedVideoMessage(stamp_ns, frame, record.encoding, record.data.tobytes())


def _foxglove(kind: Callable[..., ReadMessage], record: Any) -> ReadMessage:
    data = record.data.tobytes()
    return kind(_stamp_ns(record.timestamp), record.frame_id, record.format, data)


def _calibration(record: Any) -> CalibrationMessage:
    is_ros1 = hasattr(record, "K")
    d, k, r, p = (getattr(record, n if is_ros1 else n.lower()) for n in "DKRP")
    return calibration_message(
        RawCalibration(
            stamp_ns=_stamp_ns(record.header.stamp),
            frame=record.header.frame_id,
            size=(record.roi.width or record.width, record.roi.height or record.height),
            model=record.distortion_model,
            d=d,
            k=k,
            r=r,
            p=p,
            binning=(record.binning_x, record.binning_y),
            roi_offset=(record.roi.x_offset, record.roi.y_offset),
        )
    )


def _imu(record: Any) -> ImuMessage:
    return ImuMessage(
        _stamp_ns(record.header.stamp),
        record.header.frame_id,
        vector3(record.angular_velocity),
        vector3(record.linear_acceleration),
    )


def _transforms(record: Any) -> TransformsMessage:
    stamps = [_stamp_ns(each.header.stamp) for each in record.transforms]
    return TransformsMessage(min(stamps, default=0), tuple(map(_transform, record.transforms)))


def _transform(record: Any) -> FrameTransform:
    return FrameTransform(
        record.header.frame_id.lstrip("/"),
        record.child_frame_id.lstrip("/"),
        rigid_transform(record.transform.translation, record.transform.rotation),
        _stamp_ns(record.header.stamp),
    )


def _bare_transform(record: Any) -> BareTransformMessage:
    return BareTransformMessage(0, rigid_transform(record.translation, record.rotation))


def _transform_as_pose(record: Any) -> PoseMessage:
    each = _transform(record)
    stamp_ns = _stamp_ns(record.header.stamp)
    return PoseMessage(stamp_ns, each.parent, each.parent_from_child, each.child)


def _pose(record: Any) -> PoseMessage:
    """The pose of a PoseStamped, PoseWithCovarianceStamped or Odometry."""
    pose = getattr(record.pose, "pose", record.pose)
    velocity = getattr(record, "twist", None)
    return PoseMessage(
        _stamp_ns(record.header.stamp),
        record.header.frame_id.lstrip("/"),
        rigid_transform(pose.position, pose.orientation),
        getattr(record, "child_frame_id", "").lstrip("/"),
        None if velocity is None else _velocity(velocity),
    )


def _velocity(record: Any) -> Floats:
    """(6,) of a Twist or TwistWithCovariance."""
    twist = getattr(record, "twist", record)
    return np.concatenate([vector3(twist.linear), vector3(twist.angular)])


def _twist(record: Any) -> TwistMessage:
    frame = record.header.frame_id.lstrip("/")
    return TwistMessage(_stamp_ns(record.header.stamp), frame, _velocity(record.twist))


def _path(record: Any) -> PathMessage:
    return PathMessage(_stamp_ns(record.header.stamp), tuple(map(_pose, record.poses)))


def _position_fix(record: Any) -> PositionFixMessage:
    has_fix = record.status.status >= 0
    geodetic = np.array([record.latitude, record.longitude, record.altitude], dtype=np.float64)
    variance = float(np.mean(np.asarray(record.position_covariance)[[0, 4, 8]]))
    is_known = record.position_covariance_type > 0 and variance > 0.0
    return PositionFixMessage(
        _stamp_ns(record.header.stamp),
        geodetic if has_fix else np.full(3, np.nan),
        float(np.sqrt(variance)) if is_known else float("nan"),
    )


_CONVERTERS: dict[str, tuple[type[ReadMessage], Callable[[Any], ReadMessage]]] = {
    "sensor_msgs/msg/Image": (ImageMessage, _image),
    "sensor_msgs/msg/CompressedImage": (CompressedImageMessage, _compressed),
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": (CompressedVideoMessage, _ffmpeg_packet),
    "sensor_msgs/msg/CameraInfo": (CalibrationMessage, _calibration),
    "sensor_msgs/msg/Imu": (ImuMessage, _imu),
    "foxglove_msgs/msg/CompressedImage": (
        CompressedImageMessage,
        partial(_foxglove, encoded_message),
    ),
    "foxglove_msgs/msg/CompressedVideo": (
        CompressedVideoMessage,
        partial(_foxglove, CompressedVideoMessage),
    ),
    "tf2_msgs/msg/TFMessage": (TransformsMessage, _transforms),
    "tf/msg/tfMessage": (TransformsMessage, _transforms),
    "geometry_msgs/msg/Transform": (BareTransformMessage, _bare_transform),
    "geometry_msgs/msg/PoseStamped": (PoseMessage, _pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (PoseMessage, _pose),
    "geometry_msgs/msg/TransformStamped": (PoseMessage, _transform_as_pose),
    "geometry_msgs/msg/TwistStamped": (TwistMessage, _twist),
    "geometry_msgs/msg/TwistWithCovarianceStamped": (TwistMessage, _twist),
    "nav_msgs/msg/Odometry": (PoseMessage, _pose),
    "nav_msgs/msg/Path": (PathMessage, _path),
    "sensor_msgs/msg/NavSatFix": (PositionFixMessage, _position_fix),
}
