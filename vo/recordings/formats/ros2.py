"""Writer of messages of ROS 2 (Humble and later) in CDR."""

from __future__ import annotations

from functools import cache

import numpy as np
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from numpy.typing import ArrayLike
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_humble as ros

from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Floats
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    Dialect,
    FrameTransform,
    ImageMessage,
    ImuMessage,
    Message,
    PoseMessage,
    Schema,
    TransformsMessage,
    lens_model,
)

_NS_PER_S = 1_000_000_000
_NAMES: dict[type[Message], str] = {
    ImageMessage: "sensor_msgs/msg/Image",
    CompressedImageMessage: "sensor_msgs/msg/CompressedImage",
    CalibrationMessage: "sensor_msgs/msg/CameraInfo",
    ImuMessage: "sensor_msgs/msg/Imu",
    PoseMessage: "geometry_msgs/msg/PoseStamped",
    TransformsMessage: "tf2_msgs/msg/TFMessage",
}
# Reliable; static topics also transient local, which tf2 requires when a file is replayed. Numbers
# are rmw's enumerations, because every distribution reads them.
_QOS = """\
- history: {history}
  depth: {depth}
  reliability: 1
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: 1
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""
_STATIC_QOS = _QOS.format(history=1, depth=1, durability=1)
_USUAL_QOS = _QOS.format(history=1, depth=10, durability=2)


@cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


def schema(kind: type[Message]) -> Schema:
    """The definition of a message type, with those of its fields."""
    text, _ = _store().generate_msgdef(_NAMES[kind], ros_version=2)
    return Schema(_NAMES[kind], text.encode())


def encode(message: Message) -> bytes:
    """Serialise a message as little-endian CDR."""
    data = _store().serialize_cdr(_ros(message), _NAMES[type(message)], little_endian=True)
    return bytes(data)


def channel_metadata(topic: str) -> dict[str, str]:
    """The quality-of-service profile of a topic for replay."""
    is_static = topic.endswith("_static")
    return {"offered_qos_profiles": _STATIC_QOS if is_static else _USUAL_QOS}


def _ros(message: Message) -> object:
    match message:
        case ImageMessage():
            return ros.sensor_msgs__msg__Image(
                header=_header(message.stamp_ns, message.frame),
                height=message.height,
                width=message.width,
                encoding=message.pixel_format,
                is_bigendian=0,
                step=message.row_bytes,
                data=np.frombuffer(message.data, dtype=np.uint8),
            )
        case CompressedImageMessage():
            return ros.sensor_msgs__msg__CompressedImage(
                header=_header(message.stamp_ns, message.frame),
                format=message.image_format,
                data=np.frombuffer(message.data, dtype=np.uint8),
            )
        case CalibrationMessage():
            return _camera_info(message)
        case ImuMessage():
            return _imu(message)
        case PoseMessage():
            x, y, z = message.pose[:3, 3].tolist()
            pose = ros.geometry_msgs__msg__Pose(
                position=ros.geometry_msgs__msg__Point(x=x, y=y, z=z),
                orientation=_quaternion(message.pose),
            )
            header = _header(message.stamp_ns, message.frame)
            return ros.geometry_msgs__msg__PoseStamped(header=header, pose=pose)
        case TransformsMessage():
            stamp = message.stamp_ns
            return ros.tf2_msgs__msg__TFMessage(
                transforms=[_transform(stamp, each) for each in message.transforms]
            )


def _camera_info(message: CalibrationMessage) -> object:
    camera = message.camera
    model, coefficients = lens_model(camera, fisheye="equidistant")
    whole_image = ros.sensor_msgs__msg__RegionOfInterest(
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return ros.sensor_msgs__msg__CameraInfo(
        header=_header(message.stamp_ns, message.frame),
        height=camera.height,
        width=camera.width,
        distortion_model=model,
        d=_doubles(coefficients),
        k=_doubles(camera.matrix),
        r=_doubles(message.rectified_from_cam),
        p=_doubles(message.projection),
        binning_x=0,
        binning_y=0,
        roi=whole_image,
    )


def _imu(message: ImuMessage) -> object:
    no_orientation = np.zeros(9)
    no_orientation[0] = -1.0  # means: no orientation (definition of sensor_msgs/Imu)
    return ros.sensor_msgs__msg__Imu(
        header=_header(message.stamp_ns, message.frame),
        orientation=ros.geometry_msgs__msg__Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=no_orientation,
        angular_velocity=_vector(message.gyro),
        angular_velocity_covariance=message.gyro_variance * np.eye(3).ravel(),
        linear_acceleration=_vector(message.accel),
        linear_acceleration_covariance=message.accel_variance * np.eye(3).ravel(),
    )


def _transform(stamp_ns: int, each: FrameTransform) -> ros.geometry_msgs__msg__TransformStamped:
    transform = ros.geometry_msgs__msg__Transform(
        translation=_vector(each.parent_from_child[:3, 3]),
        rotation=_quaternion(each.parent_from_child),
    )
    return ros.geometry_msgs__msg__TransformStamped(
        header=_header(stamp_ns, each.parent), child_frame_id=each.child, transform=transform
    )


def _header(stamp_ns: int, frame: str) -> ros.std_msgs__msg__Header:
    seconds, nanoseconds = divmod(stamp_ns, _NS_PER_S)
    stamp = ros.builtin_interfaces__msg__Time(sec=seconds, nanosec=nanoseconds)
    return ros.std_msgs__msg__Header(stamp=stamp, frame_id=frame)


def _doubles(numbers: ArrayLike) -> Floats:
    """A flat float64 array: rosbags copies arrays of other types slowly, byte by byte."""
    return np.asarray(numbers, dtype=np.float64).ravel()


def _vector(xyz: Floats) -> ros.geometry_msgs__msg__Vector3:
    x, y, z = xyz.tolist()
    return ros.geometry_msgs__msg__Vector3(x=x, y=y, z=z)


def _quaternion(transform: Floats) -> ros.geometry_msgs__msg__Quaternion:
    x, y, z, w = quat_xyzw_from_rotation(transform[:3, :3]).tolist()
    return ros.geometry_msgs__msg__Quaternion(x=x, y=y, z=z, w=w)


ROS2 = Dialect(
    profile=Profile.ROS2,
    message_encoding=MessageEncoding.CDR,
    schema_encoding=SchemaEncoding.ROS2,
    schema=schema,
    encode=encode,
    channel_metadata=channel_metadata,
    # As Humble's recorder writes it: later players expect quality of service as numbers then.
    metadata={"rosbag2": {"ROS_DISTRO": "humble"}},
)
