"""Images that callers of the library give: checks, and conversion to grey."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, cast

import cv2
import numpy as np

from vo.base.errors import ConfigError, InputError
from vo.base.images.grey_stretch import Pixels, RunningStretch
from vo.base.types import Bytes

ColourOrder = Literal["bgr", "rgb"]

_TO_GREY = {
    ("bgr", 3): cv2.COLOR_BGR2GRAY,
    ("rgb", 3): cv2.COLOR_RGB2GRAY,
    ("bgr", 4): cv2.COLOR_BGRA2GRAY,
    ("rgb", 4): cv2.COLOR_RGBA2GRAY,
}


def grey_image(value: Any, name: str, colour: ColourOrder = "bgr") -> Bytes:
    """A copy of a single image as (H, W) uint8.

    Args:
        value: (H, W) or (H, W, 3) array of uint8 or uint16.
        name: of the argument, for messages.
        colour: order of the channels.

    Raises:
        InputError: it is no such array, or has no pixels.
        ConfigError: there is no such order.
    """
    check_colour(colour)
    image = in_grey(image_array(value, name), colour)
    if image.size == 0:
        raise InputError(f"{name} has shape {image.shape}, without pixels; give an image")
    if image.dtype == np.uint16:
        stretch = RunningStretch()
        stretch.update(image)
        return stretch.to_8_bits(image)
    return np.array(image, dtype=np.uint8, order="C")


def grey_mask(value: Any, name: str, shape: tuple[int, ...]) -> Bytes:
    """A mask for an image of shape (H, W) as uint8, 255 where the image may be used.

    Raises:
        InputError: it is no array of bool or uint8 of that shape.
    """
    wanted = "an (H, W) array of bool or uint8, nonzero where the image may be used"
    mask = array_of(value, name, wanted)
    if mask.dtype not in (np.bool_, np.uint8) or mask.ndim != 2:
        raise InputError(f"{name} is {mask.dtype} of shape {mask.shape}; give {wanted}")
    if mask.shape != shape:
        raise InputError(
            f"{name} has {mask.shape[1]}x{mask.shape[0]} pixels, its image {shape[1]}x{shape[0]}; "
            "give one of the same size"
        )
    return np.where(mask, np.uint8(255), np.uint8(0))


def check_colour(colour: ColourOrder) -> None:
    """Check an order of channels.

    Raises:
        ConfigError: there is no such order.
    """
    if colour not in ("bgr", "rgb"):
        raise ConfigError(f"colour is {shown(colour)}; give 'bgr' (OpenCV) or 'rgb'")


def image_array(value: Any, name: str) -> Any:
    """An image as it is, perhaps the given array itself.

    Raises:
        InputError: it is no array of uint8 or uint16 in grey or colour.
    """
    image = array_of(value, name, "an (H, W) or (H, W, 3) array of uint8 or uint16")
    if image.dtype not in (np.uint8, np.uint16):
        advice = "; scale it to 0 to 255 and convert it" if image.dtype.kind == "f" else ""
        raise InputError(f"{name} has pixels of {image.dtype}; give uint8 or uint16{advice}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 3 and image.shape[2] not in (3, 4) or image.ndim not in (2, 3):
        raise InputError(
            f"{name} has shape {image.shape}; give (H, W) in grey or (H, W, 3) in colour"
        )
    return image


def in_grey(image: Any, colour: ColourOrder) -> Pixels:
    """(H, W) of an image in grey or colour."""
    if image.ndim == 2 or image.size == 0:
        return cast("Pixels", image[:, :, 0] if image.ndim == 3 else image)
    code = _TO_GREY[colour, image.shape[2]]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), code))


def array_of(value: Any, name: str, wanted: str) -> Any:
    """The value as a plain array in native byte order; objects, such as None, are refused."""
    if value is None or isinstance(value, str | bytes | Path):
        raise InputError(f"{name} is {kind_of(value)}; give {wanted}")
    try:
        if np.ma.isMaskedArray(value):
            raise InputError(f"{name} is a masked array; give {wanted}, and mask= for the pixels")
        array = np.asarray(value)
        native = array.astype(array.dtype.newbyteorder("="), copy=False)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{name} is {kind_of(value)}, no array ({error}); give {wanted}") from None
    if native.dtype == object or native.ndim == 0:
        raise InputError(f"{name} is {kind_of(value)}; give {wanted}")
    return native


def kind_of(value: Any) -> str:
    """The type of a value in words."""
    return "None" if value is None else f"of type {type(value).__name__}"


def shown(value: Any) -> str:
    """A value for a message, cut where it is long."""
    return repr(value)[:80]
