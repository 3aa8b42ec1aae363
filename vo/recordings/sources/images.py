"""Stored images and their decoding to arrays, with detection of damaged files.

A `StoredImage` has a name and a method that reads the image on demand. `ImageFile` is an image in
a file; images in log messages and video frames are implemented beside their formats. A new kind
is a small frozen class with `name` and `read`; `decode_image` decodes PNG, JPEG and similar data.
Prefetching, size checks, skipped frames and slices are implemented in
`vo.recordings.sources.sequence`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Protocol, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_bytes
from vo.base.frozen import frozen
from vo.base.images import png
from vo.base.images.image_decoding import is_complete, quiet_opencv
from vo.base.images.image_header import MAX_PIXELS, stated_size
from vo.recordings.formats.foreign_files import foreign_image_message

Pixels = NDArray[np.unsignedinteger]
"""(H, W) grey or (H, W, 3) BGR; uint8 or uint16."""

ImageKind = Literal["grey", "colour", "recorded"]
"""Form of images: `grey`, (H, W) uint8, as the odometry requires; `colour`, 8 bits, in colour if
recorded in colour; `recorded`, unchanged, possibly with 16 bits."""

_MAX_BYTES = 512 * 2**20
_BIT_DEPTHS = (8, 10, 12, 14, 16)
_AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_FLAGS = {False: _AS_STORED, True: _AS_STORED | cv2.IMREAD_ANYCOLOR}
"""How to decode in grey and in colour. EXIF's orientation is ignored: lenses are calibrated for the
pixels as the sensor has them, and a phone may turn some images of a walk and not others."""


class StoredImage(Protocol):
    """An image that can be read on demand, any number of times.

    Each camera has one reading thread: its calls of `read` never overlap and, once frames are
    iterated, follow the order of the recording (a few images spread over the recording are read
    before). Left and right are read concurrently; state shared by them requires a lock. Files kept
    open between reads are closed by `RecordingContents.close`, at the end of each call of `frames`.
    """

    @property
    def name(self) -> str:
        """Name for messages, such as the path of a file."""
        ...

    def read(self, colour: bool = False) -> Pixels:
        """The image as stored, 8 or 16 bits.

        Args:
            colour: keep colour; otherwise it is converted to grey.

        Raises:
            SourceError: the image is missing, damaged, truncated or not an image.
        """
        ...


@frozen()
class ImageFile:
    """An image file."""

    path: Path

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def read(self, colour: bool = False) -> Pixels:
        """See `StoredImage.read`."""
        try:
            data = read_bytes(self.path, _MAX_BYTES)
        except FileNotFoundError as error:
            raise SourceError(f"image {self.path} does not exist") from error
        except OSError as error:
            raise SourceError(
                f"image {self.path} cannot be read: {error.strerror or error}"
            ) from error
        return decode_image(data, self.name, colour)


def estimate_bit_depth(images: Sequence[StoredImage]) -> int:
    """Bit depth of a camera: 8, 10, 12, 14 or 16, the smallest that fits the brightest pixel.

    One value for the whole recording, so that brightness stays comparable between images.

    Args:
        images: images of the recording; about five, evenly spread, are read, or only the first
            if it has 8 bits. Unreadable ones are ignored.
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
    return next(bits for bits in _BIT_DEPTHS if brightest < 2**bits)


def is_colour(images: Sequence[StoredImage]) -> bool:
    """Whether the first readable image is in colour."""
    for stored in images:
        try:
            return stored.read(colour=True).ndim == 3
        except SourceError:
            continue
    return False


def decode_image(data: bytes, name: str, colour: bool = False) -> Pixels:
    """Decode an image file in memory, with 8 or 16 bits, without transparency."""
    if not data:
        raise SourceError(f"image {name} is empty")
    width, height = stated_size(data) or (0, 0)
    is_small = width * height <= MAX_PIXELS
    grey = png.decode_grey(data) if is_small and data.startswith(png.SIGNATURE) else None
    if grey is not None:
        return grey
    # OpenCV fills the missing part of a truncated JPEG with grey and reports no error.
    if not is_complete(data):
        raise SourceError(f"image {name} is cut off or damaged ({len(data)} bytes)")
    if not is_small:
        raise SourceError(
            f"image {name} has {width}x{height} pixels; at most {MAX_PIXELS} are decoded"
        )
    try:
        with quiet_opencv:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), _FLAGS[colour])
    except cv2.error as error:
        raise SourceError(f"image {name} cannot be decoded: {error.err}") from error
    if image is None:
        reason = f"image {name} cannot be decoded; it is damaged or not an image"
        raise SourceError(foreign_image_message(data, name) or reason)
    if image.dtype not in (np.uint8, np.uint16):
        raise SourceError(f"image {name} has {image.dtype} pixels; 8 or 16 bits are supported")
    return cast("Pixels", image)
