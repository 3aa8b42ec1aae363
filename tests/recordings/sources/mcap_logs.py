"""Writer of MCAP files, based on MCAP's official library."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import Dialect, Message
from vo.recordings.formats.ros2 import ROS2

DIALECTS = {"foxglove": FOXGLOVE, "ros2": ROS2}


def write_log(
    path: Path,
    messages: Iterable[tuple[str, Message]],
    dialect: Dialect = ROS2,
    compression: CompressionType = CompressionType.ZSTD,
    log_ns: Any = lambda message: message.stamp_ns,
    **options: Any,
) -> Path:
    """Write messages to topics in the order given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start(profile=dialect.profile)
        schemas: dict[type[Message], int] = {}
        channels: dict[str, int] = {}
        for topic, message in messages:
            kind = type(message)
            if kind not in schemas:
                schema = dialect.schema(kind)
                schemas[kind] = writer.register_schema(
                    schema.name, dialect.schema_encoding, schema.definition
                )
            if topic not in channels:
                channels[topic] = writer.register_channel(
                    topic, dialect.message_encoding, schemas[kind]
                )
            when = log_ns(message)
            writer.add_message(channels[topic], when, dialect.encode(message), when)
        writer.finish()
    return path
