"""Whether it is the image itself that gives nothing to go by."""

from __future__ import annotations

from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.quantiles import percentiles
from vo.types import Bytes, ImageDefect

_STEP = 4  # every fourth pixel of every fourth row says enough
_BLACK, _WHITE = 16, 250
_LEAST_RANGE = 6  # of grey levels; noise of a sensor alone has about as many


def image_defect(frame: PreprocessedFrame) -> str:
    """Why no features can be found in a frame, empty where its images are not to blame."""
    for side, image in (("", frame.image0), ("right ", frame.image1)):
        light = None if image is None else _light(image)
        if light is not None:
            return f"the {side}image is {light.value}"
    return ""


def _light(image: Bytes) -> ImageDefect | None:
    low, middle, high = percentiles(image[::_STEP, ::_STEP], (5, 50, 95))
    if high < _BLACK:
        return ImageDefect.BLACK
    if middle > _WHITE:
        return ImageDefect.WHITE
    return ImageDefect.ONE_GREY if high - low < _LEAST_RANGE else None
