"""Messages of logs, independent of their encoding.

`foxglove` and `ros2` serialise them; `codecs` finds the codec that decodes them.

`frame` is a coordinate frame (`world`, `body`, `cam0`, `cam1`); `stamp_ns` is the time of
measurement in nanoseconds.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.base.types import Camera, Floats

ImageFormat = Literal["png", "jpeg"]

HEAD_BYTES = 256
"""Length of the prefix of a message that contains its stamp, in encodings that begin with it."""

_PLUMB_BOB_COEFFICIENTS = 5
_BYTES_PER_PIXEL = {"16UC1": 2, "mono16": 2, "32FC1": 4, "bgr8": 3, "bgr16": 6}
_MAX_DISTANCE_M = 1e12
_VIDEO_START = re.compile(rb"\x00\x00\x00?\x01")
_HEVC_START = re.compile(rb"\x00\x00\x00?\x01[\x00\x02\x26\x28\x2a\x40\x42\x44\x46\x4e][\x01-\x07]")
"""Slices, parameter sets, delimiters and SEI with the two-byte header of H.265, table 7-1."""
_DECODERS = {"h264": re.compile(r"[hx]\.?264|\bavc"), "hevc": re.compile(r"[hx]\.?265|hevc")}


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """An uncompressed image.

    Attributes:
        stamp_ns: middle of the exposure.
        pixel_format: name of an encoding of `vo.recordings.formats.pixels`, such as `mono8` or
            `bayer_rggb8`; `32FC1` for a depth image in metres, infinite without a surface.
        data: rows, the top one first.
        step: bytes from one row to the next; 0 for rows without padding.
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
        """Bytes from one row to the next, for the pixel formats that are written."""
        return self.step or self.width * _BYTES_PER_PIXEL.get(self.pixel_format, 1)


@dataclass(frozen=True, eq=False)
class CompressedImageMessage:
    """An encoded image file; `image_format` is `ImageFormat` if written, free text if read."""

    stamp_ns: int
    frame: str
    image_format: str
    data: bytes


@dataclass(frozen=True, eq=False)
class CompressedVideoMessage:
    """One frame of a video: `codec` see `video_decoder`, `data` begins with a start code."""

    stamp_ns: int
    frame: str
    codec: str
    data: bytes


@dataclass(frozen=True, eq=False)
class CalibrationMessage:
    """A camera and its rectification.

    Attributes:
        stamp_ns: stamp of the image that it belongs to.
        camera: the camera before rectification.
        rectified_from_cam: (3, 3) rotation into the rectified camera.
        projection: (3, 4) of the rectified camera; the last column contains the baseline.
        is_rectified_only: whether only the rectified camera is known: the matrix K was empty.
    """

    stamp_ns: int
    frame: str
    camera: Camera
    rectified_from_cam: Floats
    projection: Floats
    is_rectified_only: bool = False


@dataclass(frozen=True, eq=False)
class ImuMessage:
    """One sample of an inertial sensor.

    Attributes:
        gyro: (3,) rad/s.
        accel: (3,) m/s², specific force.
        gyro_variance: variance of the white noise of a sample, rad²/s²; 0 without noise.
        accel_variance: the same for accelerations, m²/s⁴.
    """

    stamp_ns: int
    frame: str
    gyro: Floats
    accel: Floats
    gyro_variance: float = 0.0
    accel_variance: float = 0.0


@dataclass(frozen=True, eq=False)
class PoseMessage:
    """The (4, 4) transform `frame_from_child`; `child` is empty if the message has none.

    `twist`: (6,) linear and angular velocity in the frame of the child; None without any.
    """

    stamp_ns: int
    frame: str
    pose: Floats
    child: str = ""
    twist: Floats | None = None


@dataclass(frozen=True, eq=False)
class TwistMessage:
    """The velocity of a frame in itself: (6,) linear in m/s, and angular in rad/s."""

    stamp_ns: int
    frame: str
    twist: Floats


@dataclass(frozen=True, eq=False)
class BareTransformMessage:
    """A (4, 4) transform without stamp and frames, as `geometry_msgs/Transform`."""

    stamp_ns: int
    transform: Floats


@dataclass(frozen=True, eq=False)
class PositionFixMessage:
    """A position by satellite, as `sensor_msgs/NavSatFix`.

    Attributes:
        geodetic: (3,) latitude and longitude in degrees, height in metres on WGS 84; NaN without a
            fix.
        sigma_m: standard deviation along one axis, NaN if unknown.
    """

    stamp_ns: int
    geodetic: Floats
    sigma_m: float


@dataclass(frozen=True, eq=False)
class PathMessage:
    """Poses of one path, each with its own stamp, as `nav_msgs/Path`."""

    stamp_ns: int
    poses: tuple[PoseMessage, ...]


@dataclass(frozen=True, eq=False)
class FrameTransform:
    """The (4, 4) transform `parent_from_child` between two coordinate frames.

    `stamp_ns` is 0 for messages that are written: their transforms have the stamp of the message.
    """

    parent: str
    child: str
    parent_from_child: Floats
    stamp_ns: int = 0


@dataclass(frozen=True, eq=False)
class TransformsMessage:
    """Several transforms with one stamp."""

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


ReadMessage = (
    Message
    | CompressedVideoMessage
    | PathMessage
    | BareTransformMessage
    | PositionFixMessage
    | TwistMessage
)
"""All messages that are read; those of `Message` are written too."""


@dataclass(frozen=True)
class Schema:
    """Name and definition of a message type, as needed to decode it."""

    name: str
    definition: bytes


@dataclass(frozen=True)
class Codec:
    """Decoder of a topic's messages.

    Attributes:
        decode: converts bytes to a message; raises SourceError for invalid bytes, and
            CalibrationError for an implausible camera.
        peek_stamp_ns: reads the stamp from the first `HEAD_BYTES` of a message or all of it; None
            if they do not contain it; raises SourceError for invalid bytes.
    """

    kind: type[ReadMessage]
    decode: Callable[[bytes], ReadMessage]
    peek_stamp_ns: Callable[[bytes], int | None]


@dataclass(frozen=True, eq=False)
class Dialect:
    """Encoding of messages in an MCAP file.

    Attributes:
        channel_metadata: returns the metadata of a channel, given its topic.
        metadata: metadata records of the file, by name.
    """

    profile: str
    message_encoding: str
    schema_encoding: str
    schema: Callable[[type[Message]], Schema]
    encode: Callable[[Message], bytes]
    channel_metadata: Callable[[str], dict[str, str]]
    metadata: Mapping[str, dict[str, str]]


def video_decoder(codec: str) -> str:
    """`h264` or `hevc` for names such as `avc`, `libx264` or `hevc_nvenc;yuv420p`; else nothing."""
    name = codec.lower().partition(";")[0]
    return next((key for key, names in _DECODERS.items() if names.search(name)), "")


def encoded_message(
    stamp_ns: int, frame: str, codec: str, data: bytes
) -> CompressedImageMessage | CompressedVideoMessage:
    """An encoded image, or a frame of a video, by `codec` or else by its start code."""
    if not video_decoder(codec) and _VIDEO_START.match(data):
        codec = "hevc" if _HEVC_START.match(data) else "h264"
    kind = CompressedVideoMessage if video_decoder(codec) else CompressedImageMessage
    return kind(stamp_ns, frame, codec, data)


def lens_model(camera: Camera, fisheye: str) -> tuple[str, list[float]]:
    """Name and coefficients of a camera's distortion in ROS and Foxglove.

    `fisheye`: name of the equidistant model (Kannala and Brandt, 2006) in the dialect.
    """
    coefficients = list(camera.distortion)
    if camera.distortion_model == "equidistant":
        return fisheye, coefficients
    if camera.distortion_model not in ("none", "radtan"):  # ROS and Foxglove define no name
        return camera.distortion_model, coefficients
    if len(coefficients) > _PLUMB_BOB_COEFFICIENTS:
        return "rational_polynomial", coefficients
    missing = _PLUMB_BOB_COEFFICIENTS - len(coefficients)
    return "plumb_bob", coefficients + [0.0] * missing


def vector3(vector: Any) -> Floats:
    """The coordinates x, y, z as (3,)."""
    return np.array([vector.x, vector.y, vector.z])


def rigid_transform(position: Any, rotation: Any) -> Floats:
    """The (4, 4) transform of a position (x, y, z) and a quaternion (x, y, z, w)."""
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    xyz = np.array([position.x, position.y, position.z])
    if not (np.isfinite(quat).all() and np.any(quat) and (np.abs(xyz) < _MAX_DISTANCE_M).all()):
        raise SourceError(f"position {xyz.tolist()} with quaternion {quat.tolist()} is not a pose")
    return make_transform(rotation_from_quat_xyzw(quat), xyz)
