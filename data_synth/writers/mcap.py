"""Writer of MCAP files, with messages of Foxglove or ROS 2.

Topics, for each camera N: `/camN/image_raw` or `/camN/image_raw/compressed`, `/camN/camera_info`,
`/cam0/depth` (metres); `/imu0`; `/truth/pose`, the body in the world at the rate of the inertial
sensor; `/tf`, body and movers in the world at the stamps of cam0's frames; `/tf_static`, the
cameras on the body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from data_synth.records import Imu, Recording, Shot
from data_synth.writers.encoding import EncodedShot, encoded_shots
from vo.base.geometry.rectification import rectified_projections
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Floats, Ints
from vo.base.version import __version__
from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    Dialect,
    FrameTransform,
    ImageFormat,
    ImageMessage,
    ImuMessage,
    Message,
    PoseMessage,
    TransformsMessage,
)

OnTopic = tuple[str, Message]

_IMAGE_FORMATS: dict[str, ImageFormat] = {"png": "png", "jpeg": "jpeg"}


@dataclass(frozen=True, eq=False)
class _Stream:
    """Messages at each of its stamps (N,); `messages` returns those of a row."""

    stamps_ns: Ints
    messages: Callable[[int], Iterator[OnTopic]]


def messages_of(
    recording: Recording, shots: Iterator[EncodedShot], codec: str
) -> Iterator[OnTopic]:
    """All messages of a recording with their topics, by stamp.

    A shot is taken for its first image and released after its last. The order at equal stamps is
    transforms, poses, inertial samples, images.

    Raises:
        CalibrationError: the pair cannot be rectified.
    """
    streams = [_moving_transforms(recording), _body_poses(recording)]
    if recording.imu is not None:
        streams.append(_imu_samples(recording.imu))
    streams.extend(_images(recording, shots, codec))
    first_ns = min(int(each.stamps_ns.min()) for each in streams if each.stamps_ns.size)
    yield from _in_order([_static_transforms(recording, first_ns), *streams])
    # Frames that all cameras dropped may remain.
    for _ in shots:
        pass


def _in_order(streams: Sequence[_Stream]) -> Iterator[OnTopic]:
    stamps = np.concatenate([each.stamps_ns for each in streams])
    owner = np.repeat(np.arange(len(streams)), [each.stamps_ns.size for each in streams])
    row = np.concatenate([np.arange(each.stamps_ns.size) for each in streams])
    for i in np.lexsort((row, owner, stamps)):
        yield from streams[owner[i]].messages(int(row[i]))


def _static_transforms(recording: Recording, stamp_ns: int) -> _Stream:
    transforms = [FrameTransform("body", "cam0", recording.body_from_cam0)]
    if recording.rig.cam1_from_cam0 is not None:
        cam0_from_cam1 = inverse(recording.rig.cam1_from_cam0)
        transforms.append(FrameTransform("cam0", "cam1", cam0_from_cam1))
    for number in range(2, len(recording.rig.cameras)):
        pose = recording.body_from_cams[number]
        transforms.append(FrameTransform("body", f"cam{number}", pose))
    imu = recording.imu
    if imu is not None and imu.recorded_pose is not None:
        transforms.append(FrameTransform("body", _frame_of(imu), imu.recorded_pose))
    message = TransformsMessage(stamp_ns, tuple(transforms))
    return _Stream(np.array([stamp_ns], dtype=np.int64), lambda _: iter([("/tf_static", message)]))


def _moving_transforms(recording: Recording) -> _Stream:
    """Body and movers at each frame, dropped ones included."""
    truth = recording.cam0_truth
    world_from_body = truth.world_from_cam @ inverse(recording.body_from_cam0)

    def messages(i: int) -> Iterator[OnTopic]:
        transforms = [FrameTransform("world", "body", world_from_body[i])]
        for mover in recording.movers:
            transforms.append(FrameTransform("world", mover.name, mover.world_from_mover[i]))
        yield "/tf", TransformsMessage(int(truth.stamps_ns[i]), tuple(transforms))

    return _Stream(truth.stamps_ns, messages)


def _body_poses(recording: Recording) -> _Stream:
    truth = recording.body_truth

    def messages(i: int) -> Iterator[OnTopic]:
        pose = PoseMessage(int(truth.stamps_ns[i]), "world", truth.world_from_body[i])
        yield "/truth/pose", pose

    return _Stream(truth.stamps_ns, messages)


def _frame_of(imu: Imu) -> str:
    """The frame of the sensor; one of its own if its recorded pose is wrong."""
    return imu.frame if imu.recorded_pose is None else "imu0"


def _imu_samples(imu: Imu) -> _Stream:
    # White noise of density n, sampled at rate r, has variance n² r.
    noise = imu.noise
    gyro_variance = 0.0 if noise is None else noise.gyro_noise**2 * imu.rate_hz
    accel_variance = 0.0 if noise is None else noise.accel_noise**2 * imu.rate_hz

    def messages(i: int) -> Iterator[OnTopic]:
        stamp, gyro, accel = int(imu.stamps_ns[i]), imu.gyro[i], imu.accel[i]
        yield "/imu0", ImuMessage(stamp, _frame_of(imu), gyro, accel, gyro_variance, accel_variance)

    return _Stream(imu.stamps_ns, messages)


class _ShotBuffer:
    """Shots that have been rendered and are still needed."""

    def __init__(self, shots: Iterator[EncodedShot], needs: Ints) -> None:
        """The shot of frame i will be taken `needs[i]` times."""
        self._shots = shots
        self._needs = needs
        self._waiting: dict[int, EncodedShot] = {}

    def take(self, index: int) -> EncodedShot:
        """The shot of a frame, from memory if another camera has taken it before.

        Raises:
            RuntimeError: the shots ended before that frame.
        """
        while index not in self._waiting:
            shot = next(self._shots, None)
            if shot is None:
                raise RuntimeError(f"frame {index} was not rendered")
            if self._needs[shot.index] > 0:
                self._waiting[shot.index] = shot
        self._needs[index] -= 1
        return self._waiting[index] if self._needs[index] > 0 else self._waiting.pop(index)


def _images(recording: Recording, shots: Iterator[EncodedShot], codec: str) -> list[_Stream]:
    """A stream for each camera: its calibration, its image, and the depth of cam0."""
    needs = np.sum([~dropped for dropped in recording.dropped], axis=0)
    buffer = _ShotBuffer(shots, needs)
    cameras = recording.rig.cameras
    rectified = rectified_projections(recording.rig)
    return [
        _camera(recording, number, camera, rectified[number], buffer, codec)
        for number, camera in enumerate(cameras)
    ]


def _camera(
    recording: Recording,
    number: int,
    camera: Camera,
    rectified: tuple[Floats, Floats],
    buffer: _ShotBuffer,
    codec: str,
) -> _Stream:
    kept = np.flatnonzero(~recording.dropped[number])
    stamps = recording.stamps_ns[number][kept]
    frame = f"cam{number}"

    def messages(row: int) -> Iterator[OnTopic]:
        shot, stamp = buffer.take(int(kept[row])), int(stamps[row])
        data = shot.data[number]
        assert data is not None, f"frame {shot.index} of {frame} is missing, though not dropped"
        yield f"/{frame}/camera_info", CalibrationMessage(stamp, frame, camera, *rectified)
        yield _image(stamp, frame, camera, data, codec, shot.pixel_formats[number])
        if number == 0 and shot.depth is not None:
            size, depth = (camera.width, camera.height), shot.depth.astype("<f4").tobytes()
            yield f"/{frame}/depth", ImageMessage(stamp, frame, *size, "32FC1", depth)

    return _Stream(stamps, messages)


def _image(
    stamp_ns: int, frame: str, camera: Camera, data: bytes, codec: str, pixel_format: str
) -> OnTopic:
    topic = f"/{frame}/image_raw"
    if codec == "raw":
        size = (camera.width, camera.height)
        return topic, ImageMessage(stamp_ns, frame, *size, pixel_format, data)
    message = CompressedImageMessage(stamp_ns, frame, _IMAGE_FORMATS[codec], data)
    return f"{topic}/compressed", message


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
