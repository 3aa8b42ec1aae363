"""Verification of loops: whether two stored keyframes show the same place, and how they lie."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from vo.places.records import Loop, Place
from vo.types import Camera


class RejectionReason(Enum):
    """Why two keyframes are not taken for the same place; the value is the text."""

    FEW_LANDMARKS = "{value:.0f} landmarks in one of the keyframes, {needed:.0f} needed"
    FEW_MATCHES = "{value:.0f} landmarks look alike, {needed:.0f} needed"
    NO_RELATION = "{value:.0f} landmarks agree on a relation, {needed:.0f} needed"
    FEW_INLIERS = "{value:.0f} landmarks lie and look as predicted, {needed:.0f} needed"
    SMALL_AREA = "the landmarks that agree cover {value:.2f} of the image, {needed:.2f} needed"
    MISSING_LANDMARKS = "{value:.2f} of the landmarks that should be seen are, {needed:.2f} needed"
    UNCERTAIN = "the relation is uncertain by {value:.2f} of the distance, at most {needed:.2f}"
    IMPLAUSIBLE_SCALE = "the scales differ by a factor of {value:.2f}, at most {needed:.2f}"
    ONLY_ONCE = "{value:.0f} of the keyframes in succession agree, {needed:.0f} needed"


class Rejection(NamedTuple):
    """Why a loop is not accepted.

    Attributes:
        reason: the first test that failed.
        value: the number found.
        needed: the number that it is compared with.
    """

    reason: RejectionReason
    value: float
    needed: float


class LoopVerifier:
    """Decides whether two places are the same by their landmarks.

    Args:
        scale_factor: size ratio of two pyramid levels.
        sigma_px: standard deviation of an observation, pixels.
        seed: of the random samples.
    """

    def __init__(self, scale_factor: float, *, sigma_px: float = 0.5, seed: int = 0) -> None:
        self._scale_factor = scale_factor
        self._sigma_px = sigma_px
        self._seed = seed

    def verify(
        self,
        later: Sequence[Place],
        earlier: Sequence[Place],
        camera: Camera,
        earlier_camera: Camera | None = None,
    ) -> Loop | Rejection:
        """Relation between the first keyframe of both sequences, or why there is none.

        Args:
            later: the keyframe that may see a known place, then the stored keyframes before it in
                its segment, newest first; two of them are needed for a decision.
            earlier: the stored keyframe that may show the same place, then keyframes of its segment
                that observe landmarks of it, in any order.
            camera: ideal (rectified) camera of the later keyframes.
            earlier_camera: that of the earlier ones, if it is another one.
        """
        return Rejection(RejectionReason.FEW_LANDMARKS, 0.0, 1.0)
