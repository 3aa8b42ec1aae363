"""Records of two-view geometry: what was fitted to matches of two images, or why nothing was."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Literal, NamedTuple

from vo.base.types import Bools, Floats

RobustMethod = Literal[
    "ransac", "lmeds", "usac_default", "usac_fast", "usac_accurate", "magsac", "prosac"
]
"""How a model is found among wrong matches: plain RANSAC; least median of squares, for less than
half of them wrong; and OpenCV's USAC with local optimisation, its fast and accurate settings,
MAGSAC++, and PROSAC, which tries the best matches first."""


class ModelKind(StrEnum):
    """What relates two images."""

    FUNDAMENTAL = "fundamental"
    ESSENTIAL = "essential"
    HOMOGRAPHY = "homography"


class FitFailureReason(Enum):
    """Why two-view geometry failed; the value is the text with the numbers of a `FitFailure`."""

    FEW_MATCHES = "{value:.0f} matches, {needed:.0f} needed"
    FEW_PLACES = "the matches are at {value:.0f} different places, {needed:.0f} needed"
    ON_A_LINE = "the matches lie on one line"
    NO_CONSENSUS = (
        "the images share no geometry that is better than chance: {value:.0f} of {total:.0f} "
        "matches at different places fit, {needed:.0f} are needed"
    )
    NO_MOTION = "the image does not move, so that there are no epipolar lines"
    PURE_ROTATION = "the camera only turns, so that there are no epipolar lines"
    PLANE_OR_ROTATION = "one plane, or a rotation, explains all matches; only a homography fits"
    NOT_IN_FRONT = "{value:.0f} of {needed:.0f} points are in front of both cameras, too few"


class FitOptions(NamedTuple):
    """How to fit.

    Attributes:
        threshold_px: maximum Sampson distance of an inlier: how far its two pixels together have to
            be moved to satisfy the model.
        confidence: probability of at least one sample without outliers.
        seed: of the random order in which matches are drawn.
    """

    method: RobustMethod = "usac_accurate"
    threshold_px: float = 1.5
    confidence: float = 0.9999
    seed: int = 0


class Evidence(NamedTuple):
    """Inliers and matches, each counted once per place, and how many inliers are beyond chance."""

    inliers: int
    matches: int
    needed: int

    @property
    def is_enough(self) -> bool:
        """Whether random matches would not give as many inliers."""
        return self.inliers >= self.needed


@dataclass(frozen=True, eq=False)
class Fit:
    """A model of two images.

    Attributes:
        matrix: (3, 3). Fundamental: x2^T F x1 = 0 of homogeneous pixels, of length 1; essential:
            the same of rays (x/z, y/z, 1); homography: x2 ~ H x1 of pixels, with H[2, 2] = 1.
        inlier: (N,) the matches that it explains.
        error_px: (N,) Sampson distance of each match, NaN where a pixel is.
        symmetric_px: median over the inliers of the root mean square over both images of the
            distance from the epipolar line, or from the transferred pixel.
    """

    kind: ModelKind
    matrix: Floats
    inlier: Bools
    error_px: Floats
    symmetric_px: float
    method: RobustMethod
    evidence: Evidence


class FitFailure(NamedTuple):
    """Why matches gave no model, or no pose.

    Attributes:
        value: the number found, where the reason has one.
        total: of which `value` is a part.
        refused: the model that is no better than chance.
    """

    reason: FitFailureReason
    value: float = 0.0
    needed: float = 0.0
    total: float = 0.0
    refused: Fit | None = None

    @property
    def text(self) -> str:
        """The failure as text for people."""
        return self.reason.value.format(value=self.value, needed=self.needed, total=self.total)


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Motion between two images.

    Attributes:
        second_from_first: (4, 4); the translation has length 1, as its length is unknown, or 0 if
            the camera only turns or does not move; in metres if `is_metric`.
        alternative: (4, 4) another motion that explains the matches as well, as a plane allows two
            (Faugeras and Lustman 1988); None for none.
        in_front: inliers whose point is in front of both cameras.
        parallax_deg: median angle between the rays of these.
        is_metric: it is that of a calibrated pair of cameras, which the matches confirm.
        depth_m: then the median depth of the points in the first camera.
    """

    second_from_first: Floats
    alternative: Floats | None
    in_front: int
    parallax_deg: float
    is_metric: bool = False
    depth_m: float | None = None

    @property
    def has_translation(self) -> bool:
        """Whether the cameras are at different places."""
        return bool(self.second_from_first[:3, 3].any())
