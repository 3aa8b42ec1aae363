"""Writer of MCAP files, with messages of Foxglove or ROS 2.

Topics, for each camera N: `/camN/image_raw` or `/camN/image_raw/compressed`, `/camN/camera_info`,
`/cam0/depth` (metres); `/imu0`; `/truth/pose`, the body in the world at the rate of the inertial
sensor; `/tf`, body and movers in the world at the stamps of cam0's frames; `/tf_static`, the
cameras on the body.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

from mcap.writer import CompressionType, Writer

from data_synth.records import Recording, Shot
from data_synth.writers.encoding import encoded_shots
from data_synth.writers.mcap_streams import messages_of
from vo.base.version import __version__
from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import Dialect, Message


def write_foxglove(path: Path, recording: Recording, shots: Iterator[Shot], codec: str) -> None:
    """Write a recording with Foxglove's protobuf messages.

    `path`: the file, which must not exist. `recording`: the recording without its images. `shots`:
    the images, in the order of their frames. `codec`: `png`, `jpeg` or `raw`.

    Raises:
        CalibrationError: the pair cannot be rectified.
        OSError: the file cannot be written; a partial file remains.
    """
    _write(path, recording, shots, codec, FOXGLOVE)


def write_ros2(path: Path, recording: Recording, shots: Iterator[Shot], codec: str) -> None:
    """As `write_foxglove`, with the messages of ROS 2."""
    from vo.recordings.formats.ros2 import ROS2

    _write(path, recording, shots, codec, ROS2)


def _write(
    path: Path, recording: Recording, shots: Iterator[Shot], codec: str, dialect: Dialect
) -> None:
    with path.open("xb") as stream, closing(encoded_shots(shots, codec)) as encoded:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile=dialect.profile, library=_generator())
        for name, record in {**_metadata(recording), **dialect.metadata}.items():
            writer.add_metadata(name, record)
        channels = _Channels(writer, dialect)
        for topic, message in messages_of(recording, encoded, codec):
            channels.add(topic, message)
        writer.finish()  # type: ignore[no-untyped-call]


class _Channels:
    """The channels of a file, registered with their first messages."""

    def __init__(self, writer: Writer, dialect: Dialect) -> None:
        self._writer = writer
        self._dialect = dialect
        self._schemas: dict[type[Message], int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}

    def add(self, topic: str, message: Message) -> None:
        """Write a message; log time and publish time are those of the measurement."""
        if topic not in self._channels:
            self._channels[topic] = self._register(topic, type(message))
            self._counts[topic] = 0
        self._writer.add_message(
            self._channels[topic],
            log_time=message.stamp_ns,
            publish_time=message.stamp_ns,
            data=self._dialect.encode(message),
            sequence=self._counts[topic],
        )
        self._counts[topic] += 1

    def _register(self, topic: str, kind: type[Message]) -> int:
        if kind not in self._schemas:
            schema = self._dialect.schema(kind)
            self._schemas[kind] = self._writer.register_schema(
                schema.name, self._dialect.schema_encoding, schema.definition
            )
        return self._writer.register_channel(
            topic,
            self._dialect.message_encoding,
            self._schemas[kind],
            self._dialect.channel_metadata(topic),
        )


def _generator() -> str:
    return f"vo {__version__}"


def _metadata(recording: Recording) -> dict[str, dict[str, str]]:
    """Metadata: the origin of the recording and the noise of the inertial sensor."""
    about = {
        "name": recording.name,
        "generator": _generator(),
        "frames": str(len(recording)),
        "fps": repr(float(recording.fps)),
    }
    if recording.imu is None:
        return {"recording": about}
    imu = {"rate_hz": recording.imu.rate_hz}
    if recording.imu.noise is not None:
        imu |= asdict(recording.imu.noise)
    return {"recording": about, "imu0": {name: repr(float(value)) for name, value in imu.items()}}
