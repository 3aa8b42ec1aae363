"""Why a loop is not accepted: reasons as an enum, with the numbers that led to them."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class RejectionReason(Enum):
    """Why two keyframes are not taken for the same place; the value is the text."""

    FEW_LANDMARKS = "{value:.0f} landmarks in one of the keyframes, {needed:.0f} needed"
    FEW_MATCHES = "{value:.0f} landmarks have matching descriptors, {needed:.0f} needed"
    NO_RELATION = "{value:.0f} landmarks agree on a relation, {needed:.0f} needed"
    FEW_INLIERS = "{value:.0f} landmarks agree in position and patch, {needed:.0f} needed"
    SMALL_AREA = "the landmarks that agree cover {value:.2f} of the image, {needed:.2f} needed"
    MISSING_LANDMARKS = "{value:.2f} of the expected landmarks are found, {needed:.2f} needed"
    UNCERTAIN = "the relation is uncertain by {value:.2f} of the distance, at most {needed:.2f}"
    FAR_APART = (
        "the keyframes are {value:.2f} of the distance of the landmarks apart, at most {needed:.2f}"
    )
    IMPLAUSIBLE_SCALE = "the scales differ by a factor of {value:.2f}, at most {needed:.2f}"
    FEW_WINDOWS = "{value:.0f} windows around landmarks can be compared, {needed:.0f} needed"
    DIFFERENT_IMAGES = (
        "{value:.3f} of the windows around landmarks look different, at most {needed:.3f}"
    )
    ONLY_ONCE = "{value:.0f} successive keyframes agree, {needed:.0f} needed"


class Rejection(NamedTuple):
    """The first test that failed, the number found, and the number that it is compared with."""

    reason: RejectionReason
    value: float
    needed: float
