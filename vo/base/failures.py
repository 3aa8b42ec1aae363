"""Why a frame has no pose: reasons as an enum, with the numbers that led to them."""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import NamedTuple


class ImageDefect(StrEnum):
    """What is wrong with an image: without content, or with few or unstable features."""

    BLACK = "almost black"
    WHITE = "almost white"
    ONE_GREY = "of one grey"
    CUT = "cut off"
    SMALL = "very small"
    DARK = "dark"
    LOW_CONTRAST = "of low contrast"
    INTERLACED = "interlaced"
    NOISY = "noisy"
    BLURRED = "blurred"


class FailureReason(Enum):
    """Why a frame has no pose; the value is the text with the numbers of a `Failure`."""

    REFERENCE_FRAME = "this is the reference frame"
    FEW_FEATURES = "{value:.0f} features in the image, {needed:.0f} needed"
    FEW_MATCHES = "{value:.0f} matches with the reference frame, {needed:.0f} needed"
    LITTLE_MOTION = "the image hardly moves"
    NO_ESSENTIAL_MATRIX = "no essential matrix fits the matches"
    PURE_ROTATION = "the camera only turns"
    AMBIGUOUS_PLANE = "the plane in view allows two motions"
    OTHER_ROTATION = "the motion turns by {value:.1f}° from that of the gyroscope"
    FEW_GOOD_POINTS = "{value:.0f} of {needed:.0f} inliers make good points, too few"
    LITTLE_PARALLAX = "{value:.2f}° of parallax, {needed}° needed"
    NO_DEPTH = "the right image, or depth, is missing"
    FEW_LANDMARKS = "{value:.0f} landmarks with a depth, {needed:.0f} needed"
    FEW_INLIERS = "too few landmarks agree on a pose"
    IMPLAUSIBLE_STEP = "the step needs {value:.0f} times the usual acceleration"
    IMPLAUSIBLE_SPEED = "the step needs a speed of {value:.0f} m/s"
    REPEATED_IMAGE = "the image repeats the one before while the camera moves"
    IMAGE_DEFECT = "the {side}image is {defect}"


class Failure(NamedTuple):
    """Why a frame has no pose.

    Attributes:
        value: the number found, where the reason has one.
        defect: of an image, where that is the reason, or may explain it.
    """

    reason: FailureReason
    value: float = 0.0
    needed: float = 0.0
    defect: ImageDefect | None = None
    camera: int = 0

    def __str__(self) -> str:
        """The words of `describe`."""
        return describe(self)


def describe(failure: Failure | None) -> str:
    """The failure as text for people, empty without a failure."""
    if failure is None:
        return ""
    side = "right " if failure.camera == 1 else ""
    defect = failure.defect.value if failure.defect else ""
    text = failure.reason.value.format(
        value=failure.value, needed=failure.needed, defect=defect, side=side
    )
    is_told = not defect or failure.reason is FailureReason.IMAGE_DEFECT
    return text if is_told else f"{text}; the {side}image is {defect}"


class Gap(NamedTuple):
    """A time without images of a live stream: its connection was lost, or it stalled.

    Attributes:
        first_ns: stamp of the last image before.
        last_ns: stamp of the first image after.
    """

    first_ns: int
    last_ns: int
    reason: str
