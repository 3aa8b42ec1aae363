"""What messages say, whatever the format that carries them.

`foxglove` and `ros2` write them down; `codecs` finds who reads them back.

Frames are named as everywhere (`world`, `body`, `cam0`, `cam1`); a message's stamp is when it was
measured, in nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from vo.types import Camera, Floats

ImageFormat = Literal["png", "jpeg"]

HEAD_BYTES = 256
"""Of a message; enough for its stamp in all formats that begin with it."""

_PLUMB_BOB_COEFFICIENTS = 5
_BYTES_PER_PIXEL = {"16UC1": 2, "mono16": 2, "32FC1": 4, "bgr8": 3, "bgr16": 6}


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """An image as it is in memory.

    Attributes:
        stamp_ns: middle of its exposure.
        frame: the camera.
        width: in pixels.
        height: in pixels.
        pixel_format: a name that `vo.formats.pixels` knows, such as `mono8` or `bayer_rggb8`;
            `32FC1` for a depth image in metres, infinite where nothing is hit.
        data: rows from the top.
        step: bytes from a row to the next; 0 where rows follow each other without gaps.
        big_endian: of pixels with more than 8 bits.
    """

    stamp_ns: int
    frame: str
    width: int
    height: int
    pixel_format: str
    data: bytes | memoryview
    step: int = 0
    big_endian: bool = False

    @property
    def row_bytes(self) -> int:
        """From a row to the next in bytes, of the kinds of pixels that are written."""
        return self.step or self.width * _BYTES_PER_PIXEL.get(self.pixel_format, 1)


@dataclass(frozen=True, eq=False)
class CompressedImageMessage:
    """An image as a file; what `image_format` says of it is free text where it was read."""

    stamp_ns: int
    frame: str
    image_format: str
    data: bytes


@dataclass(frozen=True, eq=False)
class CompressedVideoMessage:
    """One frame of a video; `codec` is `h264` or `h265`, `data` what begins with a start code."""

    stamp_ns: int
    frame: str
    codec: str
    data: bytes


@dataclass(frozen=True, eq=False)
class CalibrationMessage:
    """A camera, and how its images are rectified.

    Attributes:
        stamp_ns: that of the image it belongs to.
        frame: the camera.
        camera: its lens as recorded.
        rectified_from_cam: (3, 3) rotation into the rectified camera.
        projection: (3, 4) of the rectified camera; its last column places cam1 beside cam0.
    """

    stamp_ns: int
    frame: str
    camera: Camera
    rectified_from_cam: Floats
    projection: Floats


@dataclass(frozen=True, eq=False)
class ImuMessage:
    """One sample of an inertial sensor.

    Attributes:
        stamp_ns: when.
        frame: the sensor's.
        gyro: (3,) rad/s.
        accel: (3,) m/s², specific force.
        gyro_variance: of one sample's white noise, rad²/s²; 0 if it has none.
        accel_variance: the same in m²/s⁴.
    """

    stamp_ns: int
    frame: str
    gyro: Floats
    accel: Floats
    gyro_variance: float = 0.0
    accel_variance: float = 0.0


@dataclass(frozen=True, eq=False)
class PoseMessage:
    """Where something is: the (4, 4) transform from its own frame to `frame`.

    Its own frame is `child`; empty where the message does not say.
    """

    stamp_ns: int
    frame: str
    pose: Floats
    child: str = ""


@dataclass(frozen=True, eq=False)
class FrameTransform:
    """The (4, 4) transform that takes coordinates in `child` to `parent`."""

    parent: str
    child: str
    parent_from_child: Floats


@dataclass(frozen=True, eq=False)
class TransformsMessage:
    """Several transforms at one moment."""

    stamp_ns: int
    transforms: tuple[FrameTransform, ...]


Message = (
    ImageMessage
    | CompressedImageMessage
    | CalibrationMessage
    | ImuMessage
    | PoseMessage
    | TransformsMessage
)


ReadMessage = Message | CompressedVideoMessage
"""What may be found in logs; `Message` is what is written too."""


@dataclass(frozen=True)
class Schema:
    """What a reader needs to decode a kind of message: its name and its definition."""

    name: str
    definition: bytes


@dataclass(frozen=True)
class Codec:
    """How a topic's messages are read.

    Attributes:
        kind: of message.
        decode: bytes to a message; raises SourceError where they are none, and CalibrationError
            for a camera that cannot be true.
        peek_stamp_ns: the stamp from the first `HEAD_BYTES` of a message, which may be all of it;
            None where that does not tell; may raise SourceError as `decode` does.
    """

    kind: type[ReadMessage]
    decode: Callable[[bytes], ReadMessage]
    peek_stamp_ns: Callable[[bytes], int | None]


@dataclass(frozen=True, eq=False)
class Dialect:
    """A way to write messages into an MCAP file.

    Attributes:
        profile: MCAP's name of the file's rules, or empty.
        message_encoding: MCAP's name of how messages are written.
        schema_encoding: MCAP's name of how definitions are written.
        schema: the definition of a kind of message.
        encode: a message in bytes.
        channel_metadata: what stands beside a topic, by the topic's name.
        metadata: records of the file as a whole, by name.
    """

    profile: str
    message_encoding: str
    schema_encoding: str
    schema: Callable[[type[Message]], Schema]
    encode: Callable[[Message], bytes]
    channel_metadata: Callable[[str], dict[str, str]]
    metadata: Mapping[str, dict[str, str]]


def lens_model(camera: Camera, fisheye: str) -> tuple[str, list[float]]:
    """Name and coefficients of a camera's distortion, as ROS and Foxglove have them.

    Args:
        camera: any.
        fisheye: how the dialect calls the equidistant model (Kannala and Brandt, 2006).
    """
    coefficients = list(camera.distortion)
    if camera.distortion_model == "equidistant":
        return fisheye, coefficients
    if camera.distortion_model not in ("none", "radtan"):  # they have no name for these
        return camera.distortion_model, coefficients
    if len(coefficients) > _PLUMB_BOB_COEFFICIENTS:
        return "rational_polynomial", coefficients
    missing = _PLUMB_BOB_COEFFICIENTS - len(coefficients)
    return "plumb_bob", coefficients + [0.0] * missing
