"""Finds who reads a topic's messages, by how they are encoded and by the name of their schema."""

from __future__ import annotations

from vo.formats.messages import Codec


def find_codec(
    message_encoding: str, schema: str, schema_encoding: str, definition: bytes
) -> Codec | None:
    """Who reads the messages of a topic; None for kinds that nobody needs or knows.

    Args:
        message_encoding: MCAP's name: `cdr`, `ros1`, `protobuf` or `json`.
        schema: name of the schema, such as `sensor_msgs/msg/Image` or `foxglove.RawImage`.
        schema_encoding: MCAP's name, such as `ros2msg`.
        definition: the schema as stored.
    """
    # Both libraries take a while to import, and a log has seldom use for more than one.
    if message_encoding in ("cdr", "ros1"):
        from vo.formats.ros_reading import ros1_codec, ros2_codec

        if message_encoding == "ros1":
            return ros1_codec(schema, definition)
        return ros2_codec(schema, schema_encoding, definition)
    if message_encoding in ("protobuf", "json"):
        from vo.formats.foxglove_reading import foxglove_codec

        return foxglove_codec(schema, message_encoding)
    return None
