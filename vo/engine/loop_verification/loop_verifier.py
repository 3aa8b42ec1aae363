"""Verification of loops: whether two stored keyframes show the same place, and their relation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.types import Camera, Floats
from vo.engine.geometry import sim3
from vo.engine.loop_verification.image_comparison import compare_images
from vo.engine.loop_verification.landmark_search import (
    FoundLandmarks,
    KeyframePair,
    LandmarkSearch,
    agreeing,
    keyframe_pair,
)
from vo.engine.loop_verification.merged_landmarks import in_view, merge_landmarks
from vo.engine.loop_verification.relation import (
    LandmarkPairs,
    Relation,
    refine_relation,
    sample_relation,
)
from vo.engine.places.records import Loop, Place

_MIN_LANDMARKS = 30
_MIN_MATCHES = 15
_MAX_COMPARED = 600  # landmarks of neighbours, by descriptor, where the keyframe has fewer
_MIN_SAMPLED = 12  # pairs that agree with a sampled relation
_MAX_SQUARED = 9.2  # squared errors that one true pair in 100 exceeds
_MAX_NEAR = 100.0  # ... and that a better relation may make small
_MIN_INLIERS = 25
_CELLS, _MIN_AREA = 4, 0.3  # cells along each side of the image, and the ratio with inliers
# Ratio of the landmarks in view of both keyframes that are inliers. Each pass chooses landmarks of
# its own: of true pairs, 19 in 20 have 0.13 or more in a room and 0.21 in a street.
_MIN_SEEN = 0.12
_MAX_APART = 0.3  # of the keyframes, relative to the distance of the landmarks: no return if larger
_MAX_UNCERTAINTY = 0.05  # of the position, relative to the median distance of the landmarks
_MAX_METRIC_SCALE, _MAX_SCALE = 1.15, 10.0
_SUCCESSION, _MIN_SUPPORT = 3, 15  # keyframes that must agree, and inliers of each other one
# Ratio of the windows around landmarks that look different, and how many must be compared. Of true
# pairs, 19 in 20 have 0.005 or less in rendered rooms and streets, and 0.04 in a real drive.
_MAX_DIFFERENT, _MIN_WINDOWS = 0.04, 30
_COVARIANCE_SCALE = 14.0  # as in windows, see docs/accuracy.md
# Errors that more landmarks do not make smaller: radians, and of the distance of the landmarks.
_SYSTEMATIC = 5e-4


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


class LoopVerifier:
    """Decides whether two places are the same by their landmarks (docs/memory.md)."""

    def __init__(
        self,
        scale_factor: float,
        *,
        sigma_px: float = 0.5,
        seed: int = 0,
    ) -> None:
        self._search = LandmarkSearch(scale_factor, sigma_px)
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
            later: the keyframe that may be at an earlier place, then the stored keyframes before
                it in its segment, newest first; two of them are needed for a decision.
            earlier: the stored keyframe that may show the same place, then keyframes of its segment
                that observe landmarks of it, in any order.
            camera: ideal (rectified) camera of the later keyframes.
            earlier_camera: that of the earlier ones, if it is another one.
        """
        pair = keyframe_pair(later[0], earlier, camera, earlier_camera)
        guess = self._guess(pair)
        if isinstance(guess, Rejection):
            return guess
        relation, inliers = self._refine(pair, guess)
        rejection = _check_landmarks(pair, relation, inliers) or _check_relation(
            pair, relation, inliers
        )
        if rejection is not None:
            return rejection
        supported = 1 + sum(
            self._is_supported(pair, relation.earlier_from_later, later[0], before)
            for before in later[1:_SUCCESSION]
        )
        if supported < _SUCCESSION:
            return Rejection(RejectionReason.ONLY_ONCE, supported, _SUCCESSION)
        rejection = _check_images(pair, earlier, later, relation.earlier_from_later)
        if rejection is not None:
            return rejection
        return Loop(
            earlier[0].key,
            later[0].key,
            sim3.rigid_part(relation.earlier_from_later),
            float(sim3.scale_of(relation.earlier_from_later)) if pair.with_scale else 1.0,
            _covariance(pair, relation) + _systematic(inliers.pairs),
            len(inliers.later),
        )

    def _guess(self, pair: KeyframePair) -> Floats | Rejection:
        """A relation by descriptors and random samples."""
        fewest = min(pair.earlier.own, pair.later.own)
        if fewest < _MIN_LANDMARKS:
            return Rejection(RejectionReason.FEW_LANDMARKS, fewest, _MIN_LANDMARKS)
        pairs = self._search.by_descriptor(pair, max(pair.earlier.own, _MAX_COMPARED))
        count = len(pairs.earlier)
        if count < _MIN_MATCHES:
            return Rejection(RejectionReason.FEW_MATCHES, count, _MIN_MATCHES)
        relation, agrees = sample_relation(
            pairs,
            pair.intrinsics,
            pair.cameras[1].width,
            with_scale=pair.with_scale,
            seed=self._seed,
        )
        if agrees.sum() < _MIN_SAMPLED:
            return Rejection(RejectionReason.NO_RELATION, int(agrees.sum()), _MIN_SAMPLED)
        return _refined(pair, relation, pairs.select(agrees)).earlier_from_later

    def _refine(self, pair: KeyframePair, guess: Floats) -> tuple[Relation, FoundLandmarks]:
        """Search by the relation and refine it, twice; the result, and its inliers."""
        relation = Relation(guess, np.zeros((7, 7)))
        for _ in range(2):
            found = self._search.by_relation(pair, relation.earlier_from_later, _MAX_NEAR)
            if len(found.later) < _MIN_SAMPLED:
                break
            relation = _refined(pair, relation.earlier_from_later, found.pairs)
        return relation, agreeing(pair, found, relation.earlier_from_later, _MAX_SQUARED)

    def _is_supported(
        self, pair: KeyframePair, relation: Floats, later: Place, before: Place
    ) -> bool:
        """Whether a keyframe before finds enough landmarks where odometry predicts them."""
        moved = relation @ sim3.inverse(later.odom_from_cam) @ before.odom_from_cam
        other = replace(pair, later=merge_landmarks([before]))
        if other.later.own < _MIN_LANDMARKS:
            return False
        return len(self._search.by_relation(other, moved, _MAX_SQUARED).later) >= _MIN_SUPPORT


def _refined(pair: KeyframePair, relation: Floats, pairs: LandmarkPairs) -> Relation:
    return refine_relation(relation, pairs, pair.intrinsics, with_scale=pair.with_scale)


def _check_landmarks(
    pair: KeyframePair, relation: Relation, inliers: FoundLandmarks
) -> Rejection | None:
    """Whether enough landmarks agree."""
    count = len(inliers.later)
    if count < _MIN_INLIERS:
        return Rejection(RejectionReason.FEW_INLIERS, count, _MIN_INLIERS)
    area = _area(inliers.pairs.later_xy, pair.cameras[1])
    if area < _MIN_AREA:
        return Rejection(RejectionReason.SMALL_AREA, area, _MIN_AREA)
    ratio = _seen_ratio(pair, relation.earlier_from_later, inliers)
    if ratio < _MIN_SEEN:
        return Rejection(RejectionReason.MISSING_LANDMARKS, ratio, _MIN_SEEN)
    return None


def _check_relation(
    pair: KeyframePair, relation: Relation, inliers: FoundLandmarks
) -> Rejection | None:
    """Whether the keyframes are near each other, at a certain distance, and of the same scale."""
    apart = _distance_apart(relation.earlier_from_later, inliers.pairs)
    if apart > _MAX_APART:
        return Rejection(RejectionReason.FAR_APART, apart, _MAX_APART)
    distance = median(np.linalg.norm(inliers.pairs.later, axis=1))
    covariance = _covariance(pair, relation)
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])) / distance
    if not sigma < _MAX_UNCERTAINTY:
        return Rejection(RejectionReason.UNCERTAIN, sigma, _MAX_UNCERTAINTY)
    free = relation
    if not pair.with_scale:  # scales of two metric keyframes must not differ
        free = _refined(replace(pair, with_scale=True), free.earlier_from_later, inliers.pairs)
    scale = float(sim3.scale_of(free.earlier_from_later))
    factor, limit = max(scale, 1.0 / scale), _MAX_SCALE if pair.with_scale else _MAX_METRIC_SCALE
    if factor > limit:
        return Rejection(RejectionReason.IMPLAUSIBLE_SCALE, factor, limit)
    return None


def _check_images(
    pair: KeyframePair, earlier: Sequence[Place], later: Sequence[Place], relation: Floats
) -> Rejection | None:
    """Whether the images agree, also where nothing was matched."""
    windows = compare_images(pair, earlier, later, relation)
    if windows.compared < _MIN_WINDOWS:
        return Rejection(RejectionReason.FEW_WINDOWS, windows.compared, _MIN_WINDOWS)
    ratio = windows.different / windows.compared
    if ratio > _MAX_DIFFERENT:
        return Rejection(RejectionReason.DIFFERENT_IMAGES, ratio, _MAX_DIFFERENT)
    return None


def _seen_ratio(pair: KeyframePair, relation: Floats, inliers: FoundLandmarks) -> float:
    """Inliers relative to the landmarks that both keyframes should see, the mean of both."""
    own = pair.earlier.own
    expected = in_view(sim3.inverse(relation), pair.earlier.xyz, *pair.cameras).rows < own
    back = in_view(relation, pair.later.xyz, *pair.cameras[::-1])
    first = int((inliers.earlier < own).sum()) / max(int(expected.sum()), 1)
    second = len(inliers.later) / max(len(back.rows), 1)
    return 0.5 * (first + second)


def _area(xy: Floats, camera: Camera) -> float:
    """Ratio of the cells of the image that hold pixels."""
    cells = np.clip(_CELLS * xy / (camera.width, camera.height), 0, _CELLS - 1).astype(np.int64)
    return len(set(map(tuple, cells.tolist()))) / _CELLS**2


def _distance_apart(relation: Floats, pairs: LandmarkPairs) -> float:
    """Distance of the keyframes relative to the median distance of the landmarks that agree.

    The smaller of that from both keyframes: down a street, much is also seen from far away.
    """
    from_earlier = median(np.linalg.norm(pairs.earlier, axis=1))
    from_later = median(np.linalg.norm(pairs.later, axis=1))
    nearer = min(from_earlier, from_later * float(sim3.scale_of(relation)))
    return float(np.linalg.norm(relation[:3, 3])) / nearer


def _systematic(pairs: LandmarkPairs) -> Floats:
    """(7, 7) covariance of errors that landmarks have in common."""
    distance = median(np.linalg.norm(pairs.later, axis=1))
    return np.diag(_SYSTEMATIC * np.r_[np.ones(3), np.full(3, distance), 0.0]) ** 2


def _covariance(pair: KeyframePair, relation: Relation) -> Floats:
    """(7, 7) covariance of the relation, huge if it is not determined."""
    size = 7 if pair.with_scale else 6
    result = np.zeros((7, 7))
    try:
        inverse = np.linalg.inv(relation.information[:size, :size])
    except np.linalg.LinAlgError:
        inverse = np.diag(np.full(size, 1e12))
    result[:size, :size] = _COVARIANCE_SCALE * inverse
    return result
