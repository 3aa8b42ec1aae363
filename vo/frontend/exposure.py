"""Detection of images without content: black, white, or of one grey."""

from __future__ import annotations

from vo.failures import Failure, FailureReason, ImageDefect
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.quantiles import percentiles
from vo.types import Bytes

_STEP = 4  # every fourth pixel of every fourth row is enough for percentiles
_BLACK, _WHITE = 16, 250
_MIN_RANGE = 6  # grey levels; the noise of a sensor alone has about as many


def image_failure(frame: PreprocessedFrame) -> Failure | None:
    """The defect of the first image of a frame that has one, None if all have content."""
    for camera, image in enumerate(frame.images):
        defect = None if image is None else image_defect(image)
        if defect is not None:
            return Failure(FailureReason.IMAGE_DEFECT, defect=defect, camera=camera)
    return None


def image_defect(image: Bytes) -> ImageDefect | None:
    """The defect of an (H, W) uint8 image, if it has one."""
    low, middle, high = percentiles(image[::_STEP, ::_STEP], (5, 50, 95))
    if high < _BLACK:
        return ImageDefect.BLACK
    if middle > _WHITE:
        return ImageDefect.WHITE
    return ImageDefect.ONE_GREY if high - low < _MIN_RANGE else None
