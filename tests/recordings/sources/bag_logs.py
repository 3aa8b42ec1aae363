"""Writer of ROS bags, based on `rosbags`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vo.recordings.formats.messages import Message
from vo.recordings.formats.ros2 import ROS2

Packed1 = Rosbag1Writer.CompressionFormat


def write_bag1(
    path: Path, messages: Iterable[tuple[str, Message]], compression: Packed1 | None = Packed1.LZ4
) -> Path:
    """Write a ROS 1 bag."""
    path.parent.mkdir(parents=True, exist_ok=True)
    store, of_ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    transforms = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    writer = Rosbag1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {}
        for topic, message in messages:
            kind = ROS2.schema(type(message)).name
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            data = of_ros2.cdr_to_ros1(ROS2.encode(message), kind)
            writer.write(connections[topic], message.stamp_ns, data)
    return path


def write_bag2(
    path: Path,
    messages: Iterable[tuple[str, Message]],
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Write a ROS 2 bag, a folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Rosbag2Writer(path, version=9, storage_plugin=plugin)
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, message in messages:
            kind = ROS2.schema(type(message)).name
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], message.stamp_ns, ROS2.encode(message))
    return path
