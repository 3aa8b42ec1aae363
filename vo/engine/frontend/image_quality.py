"""Defects of images that keep features from being found, or found again."""

from __future__ import annotations

from vo.base.failures import Failure, FailureReason, ImageDefect
from vo.base.geometry.quantiles import percentiles
from vo.base.types import Bytes
from vo.engine.frontend.contrast import noise_level
from vo.engine.frontend.image_faults import MAX_BLUR, SMALL_PIXELS, blur, share_of_combs
from vo.engine.frontend.preprocessing import PreprocessedFrame

_STEP = 4  # every fourth pixel of every fourth row is enough for percentiles
_BLACK, _WHITE = 16, 250
_MIN_RANGE = 6  # grey levels; the noise of a sensor alone has about as many

# Limits of defects that are named only where tracking has failed. Well exposed, sharp recordings
# have: 95th percentile above 175, range above 130, blur below 0.4, noise below 3 grey levels.
_DARK = 60
_LOW_RANGE = 30
_NOISY = 15.0

# Failures that a defect of the image may explain.
_OF_IMAGES = frozenset(
    {
        FailureReason.FEW_FEATURES,
        FailureReason.FEW_MATCHES,
        FailureReason.NO_ESSENTIAL_MATRIX,
        FailureReason.FEW_GOOD_POINTS,
        FailureReason.FEW_LANDMARKS,
        FailureReason.FEW_INLIERS,
    }
)


def explained(failure: Failure | None, frame: PreprocessedFrame) -> Failure | None:
    """A failure of a frame, with the defect of its image that explains it, if there is one."""
    for camera, image in enumerate(frame.images):
        defect = None if image is None else missing_content(image)
        if defect is not None:
            return Failure(FailureReason.IMAGE_DEFECT, defect=defect, camera=camera)
    if failure is None or failure.reason not in _OF_IMAGES:
        return failure
    return failure._replace(defect=image_defect(frame.image0))


def missing_content(image: Bytes) -> ImageDefect | None:
    """Why an (H, W) uint8 image has no content: black, white, or of one grey; else None."""
    low, middle, high = percentiles(image[::_STEP, ::_STEP], (5, 50, 95))
    if high < _BLACK:
        return ImageDefect.BLACK
    if middle > _WHITE:
        return ImageDefect.WHITE
    return ImageDefect.ONE_GREY if high - low < _MIN_RANGE else None


def image_defect(image: Bytes) -> ImageDefect | None:
    """The first defect of an (H, W) uint8 image that makes features rare or unstable, or None."""
    low, high = percentiles(image[::_STEP, ::_STEP], (5, 95))
    if image.size < SMALL_PIXELS:
        return ImageDefect.SMALL
    if high < _DARK:
        return ImageDefect.DARK
    if high - low < _LOW_RANGE:
        return ImageDefect.LOW_CONTRAST
    if share_of_combs(image) > 0:
        return ImageDefect.INTERLACED
    if noise_level(image) > _NOISY:
        return ImageDefect.NOISY
    return ImageDefect.BLURRED if blur(image) > MAX_BLUR else None
