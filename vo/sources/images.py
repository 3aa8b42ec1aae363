"""Images wherever they are stored, as arrays; a damaged one is known when it is seen.

A `StoredImage` is an image that nobody has read yet: its name and a way to read it. Files are one
kind (`ImageFile`); messages of a log, frames of a video or rows of a database are others, kept
where their format is. Whoever adds a kind writes a small frozen class with a `name` and a `read`;
`decode_image` turns the bytes of PNG, JPEG and the like into pixels. All else, reading ahead,
checks of size, what is skipped, slices, comes with `vo.sources.sequence`.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.errors import SourceError
from vo.formats import png
from vo.types import Bytes

Pixels = NDArray[np.unsignedinteger]
"""(H, W) grey or (H, W, 3) blue, green, red; uint8 or uint16."""

ImageKind = Literal["grey", "colour", "recorded"]
"""What images are read as: (H, W) uint8, as the odometry needs them; with 8 bits, in colour where
they were recorded so; or as they were recorded, also with 16 bits."""

_JPEG = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_JPEG_SCAN = 0xDA
_DEPTHS = (8, 10, 12, 14, 16)
_IN_COLOUR = {False: cv2.IMREAD_ANYDEPTH, True: cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR}


class StoredImage(Protocol):
    """An image that can be read when it is needed, as often as that may be.

    `read` is called from a thread of its camera: never twice at a time by one camera, and in the
    order of the recording once frames are asked for (a few images spread over the recording are
    looked at before). Left and right are read at the same time; what they share needs a lock. What
    stays open between reads is closed by `Gathered.close`, at the end of each call of `frames`.
    """

    @property
    def name(self) -> str:
        """What messages call it; the path of a file."""
        ...

    def read(self, colour: bool = False) -> Pixels:
        """The image as stored, 8 or 16 bits.

        Args:
            colour: leave colour as it is; else it is turned to grey.

        Raises:
            SourceError: it is missing, damaged, cut off or no image; the frame is then skipped.
        """
        ...


@dataclass(frozen=True)
class ImageFile:
    """An image in a file of its own."""

    path: Path

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def read(self, colour: bool = False) -> Pixels:
        """The image as `StoredImage.read` has it; also raises as that does."""
        if self.path.is_fifo() or self.path.is_char_device():  # reading it may never end
            raise SourceError(f"image {self.path} is no file but a device or a pipe")
        try:
            data = self.path.read_bytes()
        except FileNotFoundError as error:
            raise SourceError(f"image {self.path} does not exist") from error
        except OSError as error:
            raise SourceError(
                f"image {self.path} cannot be read: {error.strerror or error}"
            ) from error
        return decode_image(data, self.name, colour)


class _Quiet:
    """Silences OpenCV's log, which would only repeat our errors, while any thread is inside."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._level = 0

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                silent = cv2.utils.logging.LOG_LEVEL_SILENT
                self._level = cv2.utils.logging.setLogLevel(silent)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                cv2.utils.logging.setLogLevel(self._level)


_quiet_opencv = _Quiet()


def read_grey(stored: StoredImage, depth_bits: int = 16) -> Bytes:
    """Read an image as (H, W) uint8.

    Args:
        stored: where it is.
        depth_bits: for images of 16 bits per pixel, how many of them the camera uses; the upper 8
            of these are kept.

    Raises:
        SourceError: it is missing, damaged, cut off or no image.
    """
    return _in_8_bits(stored.read(), depth_bits)


def read_image(stored: StoredImage, kind: ImageKind, depth_bits: int = 16) -> Pixels:
    """Read an image as another kind than grey too; else as `read_grey`."""
    image = stored.read(colour=kind != "grey")
    return image if kind == "recorded" else _in_8_bits(image, depth_bits)


def _in_8_bits(image: Pixels, depth_bits: int) -> Bytes:
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    return np.asarray(np.minimum(image >> (depth_bits - 8), 255), dtype=np.uint8)


def depth_bits_of(images: Sequence[StoredImage]) -> int:
    """How many bits a camera uses: 8, 10, 12, 14 or 16, whichever holds the brightest pixel.

    One figure for a whole recording, so that brightness stays comparable from image to image.

    Args:
        images: those of the recording; five of them, evenly spread, are looked at unless the
            first has 8 bits. Those that cannot be read are left out.
    """
    brightest = 0
    for stored in images[:: max(1, len(images) // 5)]:
        try:
            image = stored.read()
        except SourceError:
            continue
        if image.dtype == np.uint8:
            return 8
        brightest = max(brightest, int(image.max()))
    return next(bits for bits in _DEPTHS if brightest < 2**bits)


def is_in_colour(images: Sequence[StoredImage]) -> bool:
    """Whether the first image that can be read is in colour."""
    for stored in images:
        try:
            return stored.read(colour=True).ndim == 3
        except SourceError:
            continue
    return False


def decode_image(data: bytes, name: str, colour: bool = False) -> Pixels:
    """The image that a file in memory holds, 8 or 16 bits, without transparency.

    Args:
        data: PNG, JPEG or any other kind of file that OpenCV knows.
        name: of the image, for messages.
        colour: leave colour as it is; else it is turned to grey.

    Raises:
        SourceError: it is empty, damaged, cut off or no image.
    """
    if not data:
        raise SourceError(f"image {name} is empty")
    # OpenCV fills what is missing of a cut-off JPEG with grey and says nothing to the caller.
    if not is_complete(data):
        raise SourceError(f"image {name} is cut off or damaged ({len(data)} bytes)")
    grey = png.decode_grey(data) if data.startswith(png.SIGNATURE) else None
    if grey is not None:
        return grey
    try:
        with _quiet_opencv:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), _IN_COLOUR[colour])
    except cv2.error as error:
        raise SourceError(f"image {name} cannot be decoded: {error.err}") from error
    if image is None:
        raise SourceError(f"image {name} cannot be decoded; it is damaged or no image")
    if image.dtype not in (np.uint8, np.uint16):
        raise SourceError(f"image {name} has {image.dtype} pixels; 8 or 16 bits are understood")
    return cast("Pixels", image)


def is_complete(data: bytes) -> bool:
    """Whether a PNG or JPEG file reaches its end mark undamaged; True for other formats."""
    if data.startswith(png.SIGNATURE):
        return png.is_complete(data)
    if data.startswith(_JPEG):
        return _jpeg_is_complete(data)
    return True


def _jpeg_is_complete(data: bytes) -> bool:
    """Walk the segments to the first scan, past any thumbnail, and look for the end from there."""
    position = len(_JPEG)
    while position + 4 <= len(data) and data[position] == 0xFF:
        if data[position + 1] == _JPEG_SCAN:
            return data.find(_JPEG_END, position) >= 0
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return False
