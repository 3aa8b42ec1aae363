"""Bags of the RealSense SDK and Viewer: streams, and their poses on the device.

All images have the frame `0`, so that streams are told apart by their topics:
`/device_0/sensor_0/Infrared_1` with `/image/data`, `/info/camera_info` and `/tf/0`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from vo.base.errors import VoError
from vo.base.geometry.transforms import inverse
from vo.recordings.formats.messages import (
    BareTransformMessage,
    FrameTransform,
    TransformsMessage,
)
from vo.recordings.sources.logs.log import Entry, Log, Topic

_STREAM = re.compile(
    r"((/device_\d+)/sensor_\d+/\w+)/(?:image/data|imu/data|info/camera_info|tf/(\d+))"
)


def stream_of(topic: str) -> str:
    """The stream that a topic belongs to, used as a coordinate frame; empty in other logs."""
    found = _STREAM.fullmatch(topic)
    return found[1] if found else ""


def extrinsics_topics(topics: Sequence[Topic]) -> list[Topic]:
    """Topics `/tf/N` of streams."""
    bare = (topic for topic in topics if issubclass(topic.codec.kind, BareTransformMessage))
    return [topic for topic in bare if stream_of(topic.name)]


def stream_transforms(
    log: Log, topics: Sequence[Topic], entries: Mapping[str, Sequence[Entry]]
) -> TransformsMessage:
    """The streams' poses relative to reference N of their device.

    A message maps points from the reference to the stream.
    Source: librealsense, `device::get_extrinsics` and `ros2_writer::write_extrinsics`.
    """
    found = []
    for topic in extrinsics_topics(topics):
        names = _STREAM.fullmatch(topic.name)
        for entry in entries[topic.name][:1] if names else ():
            assert names is not None
            try:
                message = topic.codec.decode(log.read(entry))
            except VoError:
                continue
            if isinstance(message, BareTransformMessage):
                pose = inverse(message.transform)
                found.append(FrameTransform(f"{names[2]}/tf/{names[3]}", names[1], pose))
    return TransformsMessage(0, tuple(found))
