"""The two kinds of MCAP file: writers, decoders, and access to fields of messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoder
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder
from recordings import make_shots

from data_synth.records import Recording, Write
from data_synth.writers.mcap import write_foxglove, write_ros2
from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.base.types import Floats


@dataclass(frozen=True)
class Dialect:
    """A writer, an independent decoder, and access to fields of messages."""

    write: Write
    decoder: Callable[[], Any]
    stamp_ns: Callable[[Any], int]
    frame: Callable[[Any], str]
    transform: Callable[[Any], tuple[str, str, Floats]]
    schemas: dict[str, str]


def quat_transform(position: Any, rotation: Any) -> Floats:
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    return make_transform(
        rotation_from_quat_xyzw(quat), np.array([position.x, position.y, position.z])
    )


FOXGLOVE = Dialect(
    write=write_foxglove,
    decoder=ProtobufDecoder,
    stamp_ns=lambda m: m.timestamp.seconds * 10**9 + m.timestamp.nanos,
    frame=lambda m: str(m.frame_id),
    transform=lambda t: (
        t.parent_frame_id,
        t.child_frame_id,
        quat_transform(t.translation, t.rotation),
    ),
    schemas={
        "/tf": "foxglove.FrameTransforms",
        "/tf_static": "foxglove.FrameTransforms",
        "/truth/pose": "foxglove.PoseInFrame",
        "/imu0": "vo.Imu",
        "/cam0/camera_info": "foxglove.CameraCalibration",
        "/cam0/image_raw": "foxglove.RawImage",
        "/cam0/depth": "foxglove.RawImage",
        "/cam1/camera_info": "foxglove.CameraCalibration",
        "/cam1/image_raw": "foxglove.RawImage",
    },
)
ROS2 = Dialect(
    write=write_ros2,
    decoder=Ros2Decoder,
    stamp_ns=lambda m: m.header.stamp.sec * 10**9 + m.header.stamp.nanosec,
    frame=lambda m: str(m.header.frame_id),
    transform=lambda t: (
        t.header.frame_id,
        t.child_frame_id,
        quat_transform(t.transform.translation, t.transform.rotation),
    ),
    schemas={
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/truth/pose": "geometry_msgs/msg/PoseStamped",
        "/imu0": "sensor_msgs/msg/Imu",
        "/cam0/camera_info": "sensor_msgs/msg/CameraInfo",
        "/cam0/image_raw": "sensor_msgs/msg/Image",
        "/cam0/depth": "sensor_msgs/msg/Image",
        "/cam1/camera_info": "sensor_msgs/msg/CameraInfo",
        "/cam1/image_raw": "sensor_msgs/msg/Image",
    },
)


def write(dialect: Dialect, path: Path, recording: Recording, codec: str = "raw") -> Path:
    dialect.write(path, recording, make_shots(recording), codec)
    return path


def read(dialect: Dialect, path: Path, topic: str) -> list[tuple[int, Any]]:
    """Log times and messages of a topic."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[dialect.decoder()])
        return [(m.log_time, d) for _, _, m, d in reader.iter_decoded_messages(topics=[topic])]


def transforms(dialect: Dialect, path: Path, topic: str) -> dict[tuple[str, str], list[Floats]]:
    found: dict[tuple[str, str], list[Floats]] = {}
    for _, message in read(dialect, path, topic):
        for parent, child, parent_from_child in map(dialect.transform, message.transforms):
            found.setdefault((parent, child), []).append(parent_from_child)
    return found


def matrix(message: Any, name: str) -> Floats:
    numbers = getattr(message, name, None)
    if numbers is None:
        numbers = getattr(message, name.lower())
    return np.reshape(list(numbers), (3, -1))
