"""Reader of masks: images that are 0 (black) where other images are not to be used."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import ConfigError
from vo.base.files.bounded_files import read_bytes
from vo.base.images.image_decoding import JPEG, is_complete, quiet_opencv
from vo.base.images.image_header import MAX_PIXELS, stated_size
from vo.base.types import Bools

_MAX_BYTES = 2**27
_CONVENTION = "black (0) is not used, all other pixels are"


def read_mask(path: Path) -> Bools:
    """Where images are used, (H, W): where the mask is not 0.

    A pixel in colour is 0 if all channels are. Transparent pixels count as 0. JPEG does not keep
    values, so that what is darker than half of the brightest pixel is 0 there. As for all images,
    EXIF's orientation is ignored.

    Raises:
        ConfigError: the file is missing, damaged or no image, or 0 everywhere.
    """
    pixels, is_exact = _decoded(path)
    if pixels.ndim == 3 and pixels.shape[2] in (2, 4):
        opaque = pixels[..., -1] > 0
        pixels = pixels[..., :-1] * opaque[..., None]
    if pixels.ndim == 3:
        pixels = pixels.max(axis=2)
    brightest = pixels.max()
    if not brightest > 0:
        raise ConfigError(f"mask {path} is 0 everywhere and leaves nothing: {_CONVENTION}")
    return np.asarray(pixels > (0 if is_exact else brightest // 2))


def _decoded(path: Path) -> tuple[np.ndarray, bool]:
    """The pixels as stored, and whether the format keeps their values."""
    try:
        data = read_bytes(path, _MAX_BYTES)
    except OSError as error:
        raise ConfigError(f"mask {path} cannot be read: {error.strerror or error}") from error
    width, height = stated_size(data) or (0, 0)
    if width * height > MAX_PIXELS:
        raise ConfigError(f"mask {path} has {width}x{height} pixels; at most {MAX_PIXELS} are read")
    if not is_complete(data):
        raise ConfigError(f"mask {path} is cut off or damaged ({len(data)} bytes)")
    pixels = None
    if data:
        try:
            with quiet_opencv:
                pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            raise ConfigError(f"mask {path} cannot be decoded: {error.err}") from error
    if pixels is None:
        raise ConfigError(
            f"mask {path} is no image; give a PNG of the size of the images: {_CONVENTION}"
        )
    return np.asarray(pixels), not data.startswith(JPEG)
