"""Selection of the codec of a topic, by message encoding and schema name."""

from __future__ import annotations

from vo.base.extras import require
from vo.recordings.formats.messages import Codec


def find_codec(
    message_encoding: str, schema: str, schema_encoding: str, definition: bytes
) -> Codec | None:
    """The codec of a topic's messages; None for unsupported message types.

    `message_encoding`: as in MCAP: `cdr`, `ros1`, `protobuf` or `json`.
    `schema_encoding`: as in MCAP, such as `ros2msg`.
    """
    # Both libraries are slow to import, and most logs need only one.
    if message_encoding in ("cdr", "ros1"):
        require("rosbags", extra="ros", what="ROS messages")
        from vo.recordings.formats.ros_reading import ros1_codec, ros2_codec

        if message_encoding == "ros1":
            return ros1_codec(schema, definition)
        return ros2_codec(schema, schema_encoding, definition)
    if message_encoding in ("protobuf", "json"):
        from vo.recordings.formats.foxglove_reading import foxglove_codec

        return foxglove_codec(schema, message_encoding)
    return None
