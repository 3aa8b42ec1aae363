"""Masks of a run as they are given: images and areas at the pixels of recorded images."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import ConfigError
from vo.base.files.bounded_files import read_bytes
from vo.base.images.image_areas import ImageArea, parse_area, split_cameras
from vo.base.images.image_decoding import JPEG, is_complete, quiet_opencv
from vo.base.images.image_header import MAX_PIXELS, stated_size
from vo.base.types import Bools, Bytes, Camera, Rig

_log = logging.getLogger(__name__)

CAMERA_NAMES = ("left", "right")
_MANY = 0.5  # ratio of an image that a mask seldom hides


def read_masks(
    rig: Rig, files: Sequence[str], ignore: Sequence[str], roi: Sequence[str]
) -> tuple[Bytes | None, ...]:
    """Masks (H, W) uint8 of the images of each camera as recorded, 0 or 255; None without one.

    Masks of a right camera that the rig lacks are left out.

    Raises:
        ConfigError: a mask is missing, damaged or of another size, an area is outside of the image,
            or nothing is left of an image.
    """
    by_camera = _files_by_camera(files)
    ignored = [parse_area(text) for text in ignore]
    regions = [parse_area(text) for text in roi]
    return tuple(
        _mask(number, camera, by_camera.get(number), _of(number, ignored), _of(number, regions))
        for number, camera in enumerate(rig.cameras)
    )


def _name(number: int) -> str:
    return CAMERA_NAMES[number]


def _files_by_camera(texts: Sequence[str]) -> dict[int, Path]:
    """Files by camera: those without a camera's name in order, left before right."""
    files: dict[int, Path] = {}
    following = iter((0, 1))
    for text in texts:
        cameras, path = split_cameras(text)
        for number in (next(following, 2),) if cameras is None else cameras:
            if number > 1 or number in files:
                what = "more masks than cameras" if number > 1 else f"two {_name(number)} masks"
                raise ConfigError(f"there are {what}: {', '.join(texts)}; give one for each camera")
            files[number] = Path(path)
    return files


def _of(number: int, areas: Sequence[ImageArea]) -> list[ImageArea]:
    return [area for area in areas if number in area.cameras]


def _mask(
    number: int,
    camera: Camera,
    path: Path | None,
    ignored: Sequence[ImageArea],
    regions: Sequence[ImageArea],
) -> Bytes | None:
    if path is None and not ignored and not regions:
        return None
    used = (
        np.ones((camera.height, camera.width), bool)
        if path is None
        else _read(path, number, camera)
    )
    if regions:
        used &= _filled(regions, number, camera)
    if ignored:
        used &= ~_filled(ignored, number, camera)
    if not used.any():
        raise ConfigError(
            f"masks, regions and ignored areas leave nothing of the {_name(number)} images"
        )
    return None if used.all() else used.astype(np.uint8) * np.uint8(255)


def _read(path: Path, number: int, camera: Camera) -> Bools:
    used = read_mask(path)
    height, width = used.shape
    if (width, height) != (camera.width, camera.height):
        turned = "turned by 90°" if (height, width) == (camera.width, camera.height) else ""
        raise ConfigError(
            f"mask {path} is {width}x{height}, {turned or 'not the size of'} the "
            f"{_name(number)} images ({camera.width}x{camera.height}): draw it over an image as "
            "recorded, neither rectified nor turned"
        )
    hidden = 1.0 - float(used.mean())
    if hidden == 0.0:
        _log.warning("mask %s has no black pixel (0) and hides nothing", path)
    elif hidden > _MANY:
        _log.warning(
            "mask %s hides %.0f %% of the %s images: black (0) is not used, all other pixels are",
            path,
            100.0 * hidden,
            _name(number),
        )
    return used


def _filled(areas: Sequence[ImageArea], number: int, camera: Camera) -> Bools:
    """(H, W) where the areas are."""
    inside = np.zeros((camera.height, camera.width), np.uint8)
    for area in areas:
        alone = np.zeros_like(inside)
        cv2.fillPoly(alone, [np.array(area.corners, np.int32)], 1)
        if not alone.any():
            raise ConfigError(
                f"area '{area.text}' is outside of the {_name(number)} images, which are "
                f"{camera.width}x{camera.height}"
            )
        inside |= alone
    return inside > 0


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
