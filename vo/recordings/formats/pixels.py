"""Conversion of raw pixels of messages to grey or colour images, by ROS's encoding names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.errors import SourceError
from vo.recordings.formats.messages import ImageMessage

Pixels = NDArray[np.unsignedinteger]

DEPTH_UNITS_PER_METRE = 1000.0
"""Depth is in millimetres, as in 16-bit images of ROS (REP 118); floats in metres are converted."""


@dataclass(frozen=True)
class _Layout:
    """Storage of a pixel: sample size, channels, and conversions to grey and to BGR.

    `half_rows`: rows of data for two rows of the image; more than 2 with planes of colour.
    """

    bytes_per_sample: int
    channels: int
    grey: Callable[[Pixels], Pixels]
    colour: Callable[[Pixels], Pixels]
    half_rows: int = 2

    def row_bytes(self, width: int) -> int:
        """Bytes of a row without padding."""
        return width * self.channels * self.bytes_per_sample

    def rows(self, height: int) -> int:
        """Rows of data."""
        return height * self.half_rows // 2


def _first_channel(image: Pixels) -> Pixels:
    return image[:, :, 0]


def _first_plane(image: Pixels) -> Pixels:
    return image[: len(image) * 2 // 3, :, 0]


def _first_of_three_planes(image: Pixels) -> Pixels:
    return image[: len(image) // 3, :, 0]


def _unchanged(image: Pixels) -> Pixels:
    return image


def _converted(code: int) -> Callable[[Pixels], Pixels]:
    # OpenCV expects a Bayer pattern as a two-dimensional array.
    def convert(image: Pixels) -> Pixels:
        flat = image[:, :, 0] if image.shape[2] == 1 else image
        return cast("Pixels", cv2.cvtColor(np.ascontiguousarray(flat), code))

    return convert


# OpenCV names a Bayer pattern by the pixels from the second row and column on, ROS by the first.
_BAYER = {
    "rggb": (cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    "bggr": (cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    "gbrg": (cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    "grbg": (cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
}
_LAYOUTS: dict[str, _Layout] = {
    **{
        f"{name}{bits}": _Layout(bits // 8, channels, grey, colour)
        for name, channels, grey, colour in (
            ("mono", 1, _first_channel, _first_channel),
            ("rgb", 3, _converted(cv2.COLOR_RGB2GRAY), _converted(cv2.COLOR_RGB2BGR)),
            ("bgr", 3, _converted(cv2.COLOR_BGR2GRAY), _unchanged),
            ("rgba", 4, _converted(cv2.COLOR_RGBA2GRAY), _converted(cv2.COLOR_RGBA2BGR)),
            ("bgra", 4, _converted(cv2.COLOR_BGRA2GRAY), _converted(cv2.COLOR_BGRA2BGR)),
            *(
                (f"bayer_{name}", 1, _converted(to_grey), _converted(to_bgr))
                for name, (to_grey, to_bgr) in _BAYER.items()
            ),
        )
        for bits in (8, 16)
    },
    "yuv422": _Layout(
        1, 2, _converted(cv2.COLOR_YUV2GRAY_UYVY), _converted(cv2.COLOR_YUV2BGR_UYVY)
    ),
    "yuv422_yuy2": _Layout(
        1, 2, _converted(cv2.COLOR_YUV2GRAY_YUY2), _converted(cv2.COLOR_YUV2BGR_YUY2)
    ),
}
_LAYOUTS |= {
    name: _Layout(1, 1, _first_plane, _converted(code), half_rows=3)
    for name, code in (
        ("nv12", cv2.COLOR_YUV2BGR_NV12),
        ("nv21", cv2.COLOR_YUV2BGR_NV21),
        ("i420", cv2.COLOR_YUV2BGR_I420),
        ("yv12", cv2.COLOR_YUV2BGR_YV12),
    )
} | {"nv24": _Layout(1, 1, _first_of_three_planes, _first_of_three_planes, half_rows=6)}
_MAX_PIXEL_BYTES, _MAX_OF_NEXT = 8, 0.8
_UNPADDED = ("i420", "yv12")
_OTHER_YUV = {"yuv422": "yuv422_yuy2", "yuv422_yuy2": "yuv422"}
_OTHER_NAMES = {
    "8uc1": "mono8",
    "16uc1": "mono16",
    "8uc3": "bgr8",
    "16uc3": "bgr16",
    "8uc4": "bgra8",
    "16uc4": "bgra16",
    "uyvy": "yuv422",
    "yuyv": "yuv422_yuy2",
    "yuy2": "yuv422_yuy2",
    "yuv420": "i420",
    "yuv420p": "i420",
    **dict.fromkeys(("mono", "grey", "gray", "grey8", "gray8", "y8", "l8", "l_int8"), "mono8"),
    **dict.fromkeys(("mono10", "mono12", "gray16", "y10", "y12", "y16", "l16"), "mono16"),
    **dict.fromkeys(("rgb", "rgb_int8", "r8g8b8"), "rgb8"),
    **dict.fromkeys(("bgr", "bgr_int8", "b8g8r8"), "bgr8"),
    **{f"bayer_{name}{bits}": f"bayer_{name}16" for name in _BAYER for bits in (10, 12, 14)},
}
"""Names by OpenCV, V4L2, GenICam, FFmpeg and Gazebo; 10 to 14 bits are stored in 16."""


def grey_pixels(message: ImageMessage) -> Pixels:
    """The (H, W) grey image, uint8 or uint16, of an uncompressed image."""
    layout = _layout(message)
    return layout.grey(_rows(message, layout))


def colour_pixels(message: ImageMessage) -> Pixels:
    """As `grey_pixels`, but colour and Bayer images as (H, W, 3): blue, green, red."""
    layout = _layout(message)
    return layout.colour(_rows(message, layout))


def has_wrong_step(message: ImageMessage) -> bool:
    """Whether the step is less than a row, but the data are exactly all rows."""
    layout = _layout(message)
    row_bytes = layout.row_bytes(message.width)
    whole_bytes = layout.rows(message.height) * row_bytes
    return 0 < message.step < row_bytes and len(message.data) == whole_bytes


def other_pixel_bytes(message: ImageMessage) -> int:
    """Bytes of a pixel if the rows have more than stated, without padding; 0 if not.

    Pixels so many bytes apart then are more alike than neighbouring bytes.
    """
    layout = _layout(message)
    stated, count = layout.row_bytes(1), message.step // max(message.width, 1)
    if not stated < count <= _MAX_PIXEL_BYTES or message.step != count * message.width:
        return 0
    whole = len(message.data) // message.step * message.step
    rows = np.frombuffer(message.data, np.uint8, whole).reshape(-1, message.step).astype(np.int16)
    apart, stated_apart, next_to = (
        float(np.abs(rows[:, by:] - rows[:, :-by]).mean()) for by in (count, stated, 1)
    )
    return count if apart < _MAX_OF_NEXT * min(next_to, stated_apart) else 0


def as_other_yuv(message: ImageMessage) -> ImageMessage | None:
    """The message in the other order of brightness and colour; None if it is not YUV."""
    other = _OTHER_YUV.get(_standard_name(message))
    return None if other is None else replace(message, pixel_format=other)


def _standard_name(message: ImageMessage) -> str:
    name = message.pixel_format.strip().lower()
    return _OTHER_NAMES.get(name, name)


def _layout(message: ImageMessage) -> _Layout:
    name = _standard_name(message)
    layout = _LAYOUTS.get(name)
    if layout is None:
        advice = "is that of depth; choose the topic of a camera (`topics=TOPIC`)"
        if name not in ("32fc1", "64fc1"):
            advice = (
                "is not supported; supported are mono8, mono16, rgb8, bgr8, rgba8, bgra8, bayer_*, "
                "yuv422, yuyv, nv12, nv21, nv24, i420 and yv12"
            )
        raise SourceError(f"pixel encoding '{message.pixel_format}' {advice}")
    if name in _UNPADDED and message.step > message.width:
        raise SourceError(f"rows of {message.pixel_format} with {message.step} bytes are not read")
    return layout


def _rows(message: ImageMessage, layout: _Layout) -> Pixels:
    """The samples as (H, W, channels) in native byte order, as a view if possible."""
    width, height = message.width, layout.rows(message.height)
    row_bytes = layout.row_bytes(width)
    step = message.step or row_bytes
    if has_wrong_step(message):
        step = row_bytes
    needed = (height - 1) * step + row_bytes
    if width < 1 or height < 1 or step < row_bytes or len(message.data) < needed:
        raise SourceError(
            f"image of {width}x{message.height} {message.pixel_format} with rows of {step} bytes "
            f"has {len(message.data)} bytes; {max(needed, 0)} are needed"
        )
    kind = np.dtype(np.uint8 if layout.bytes_per_sample == 1 else np.uint16)
    stored = kind.newbyteorder(">" if message.big_endian else "<")
    image = np.ndarray(
        (height, width, layout.channels),
        stored,
        message.data,
        strides=(step, layout.channels * layout.bytes_per_sample, layout.bytes_per_sample),
    )
    return image.astype(kind, copy=False)


def depth_pixels(message: ImageMessage) -> Pixels:
    """The (H, W) depth in millimetres, as uint16 or float32; floats of the message are metres."""
    if message.pixel_format.strip().upper() != "32FC1":
        return grey_pixels(message)
    height, width = message.height, message.width
    step = message.step or 4 * width
    if min(height, width) < 1 or step < 4 * width or len(message.data) < height * step:
        raise SourceError(f"{width}x{height} pixels do not fit {len(message.data)} bytes")
    stored = np.dtype(">f4" if message.big_endian else "<f4")
    metres = np.ndarray((height, width), stored, message.data, strides=(step, 4))
    finite = np.where(np.isfinite(metres), metres, 0.0).astype(np.float32)
    return cast("Pixels", finite * np.float32(DEPTH_UNITS_PER_METRE))
