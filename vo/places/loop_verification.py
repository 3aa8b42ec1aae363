"""Verification of loops: whether two stored keyframes show the same place, and how they lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vo.config import MatchingConfig
from vo.frontend.contracts import Circles, FeatureSet, Matcher
from vo.frontend.matching import HammingMatcher
from vo.geometry import sim3
from vo.geometry.projection import Intrinsics
from vo.mapping.octaves import predicted_octave
from vo.places.known_landmarks import (
    KnownLandmarks,
    in_view,
    know_landmarks,
    observed_xy,
)
from vo.places.patch_comparison import patch_correlation
from vo.places.records import Loop, Place
from vo.places.rejection import Rejection, RejectionReason
from vo.places.relation import (
    LandmarkPairs,
    Relation,
    pair_errors,
    refine_relation,
    sample_relation,
)
from vo.types import Bools, Camera, Floats, Ints

_MIN_LANDMARKS = 30
_MIN_MATCHES = 15
_MAX_COMPARED = 600  # landmarks of neighbours, by descriptor, where the keyframe has fewer
_MIN_SAMPLED = 12  # pairs that agree with a sampled relation
_MIN_INLIERS = 25
_SUCCESSION, _MIN_SUPPORT = 3, 15  # keyframes that must agree, and inliers of each other one
_SAMPLE_RATIO, _MIN_SAMPLE_PX = 0.01, 4.0  # threshold of samples, ratio of the image width
_SEARCH_RATIO, _MIN_SEARCH_PX = 0.012, 5.0  # radius around predicted positions
_MAX_SQUARED = 9.2  # squared errors that one true pair in 100 exceeds
_MAX_NEAR = 100.0  # those that may be small with a better relation
_MIN_CORRELATION = 0.6
_CELLS, _MIN_AREA = 4, 0.3  # cells along each side of the image, and the ratio with inliers
# Ratio of the landmarks in view of both keyframes that are inliers. Each pass chooses landmarks of
# its own: of true pairs, 19 in 20 have 0.13 or more in a room and 0.21 in a street.
_MIN_SEEN = 0.12
_MAX_UNCERTAINTY = 0.05  # of the position, relative to the median distance of the landmarks
_MAX_APART = 0.3  # of the keyframes, relative to the distance of the landmarks: no return if larger
_MAX_METRIC_SCALE, _MAX_SCALE = 1.15, 10.0
# Observations of two passes are of different landmarks at the same corner.
_SIGMA_FACTOR = 2.0
_COVARIANCE_SCALE = 14.0  # as in windows, see docs/accuracy.md


@dataclass(frozen=True, eq=False)
class _Found:
    """Pairs of landmarks found by a relation.

    Attributes:
        rows: (n,) of the earlier landmarks.
        later: (n,) rows of the later ones.
        pairs: the n pairs.
        correlation: (n,) of their patches.
    """

    rows: Ints
    later: Ints
    pairs: LandmarkPairs
    correlation: Floats


class LoopVerifier:
    """Decides whether two places are the same by their landmarks.

    Matches of descriptors give a relation of the keyframes, by which all landmarks of one are
    searched in the other. Those found must lie where they are predicted in both images, look alike,
    cover the image, and be a good part of those that both keyframes should see: what is missing
    speaks against the place. Keyframes before must find the same.

    Args:
        scale_factor: size ratio of two pyramid levels.
        sigma_px: standard deviation of an observation, pixels.
        seed: of the random samples.
        matcher: of the landmarks' descriptors.
    """

    def __init__(
        self,
        scale_factor: float,
        *,
        sigma_px: float = 0.5,
        seed: int = 0,
        matcher: Matcher | None = None,
    ) -> None:
        self._scale_factor = scale_factor
        self._sigma_px = sigma_px
        self._seed = seed
        self._matcher = matcher or HammingMatcher(MatchingConfig())

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
        cameras = (earlier_camera or camera, camera)
        with_scale = not (later[0].is_metric and earlier[0].is_metric)
        known = know_landmarks(earlier)
        seen = know_landmarks(later[:1])
        fewest = min(known.own, seen.own)
        if fewest < _MIN_LANDMARKS:
            return Rejection(RejectionReason.FEW_LANDMARKS, fewest, _MIN_LANDMARKS)
        guess = self._guess(known, seen, cameras, with_scale)
        if isinstance(guess, Rejection):
            return guess
        relation, found = self._refine(guess, known, seen, cameras, with_scale)
        inlier = self._inliers(found, relation.squared)
        rejection = self._check(relation, found, inlier, known, seen, cameras, with_scale)
        if rejection is not None:
            return rejection
        agreeing = 1 + sum(
            self._is_supported(relation.earlier_from_later, known, later[0], before, cameras)
            for before in later[1:_SUCCESSION]
        )
        if agreeing < _SUCCESSION:
            return Rejection(RejectionReason.ONLY_ONCE, agreeing, _SUCCESSION)
        return Loop(
            earlier[0].key,
            later[0].key,
            sim3.rigid_part(relation.earlier_from_later),
            float(sim3.scale_of(relation.earlier_from_later)) if with_scale else 1.0,
            _covariance(relation.information, with_scale),
            int(inlier.sum()),
        )

    def _guess(
        self,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        cameras: tuple[Camera, Camera],
        with_scale: bool,
    ) -> Floats | Rejection:
        """A relation by descriptors and random samples."""
        matches = self._matcher.match(
            _features(known, max(known.own, _MAX_COMPARED)), _features(seen)
        )
        if len(matches.query) < _MIN_MATCHES:
            return Rejection(RejectionReason.FEW_MATCHES, len(matches.query), _MIN_MATCHES)
        pairs = self._pairs(known, seen, matches.query, matches.train, cameras)
        threshold_px = max(_SAMPLE_RATIO * cameras[1].width, _MIN_SAMPLE_PX)
        relation, agrees = sample_relation(
            pairs, _intrinsics(cameras), threshold_px, with_scale=with_scale, seed=self._seed
        )
        if agrees.sum() < _MIN_SAMPLED:
            return Rejection(RejectionReason.NO_RELATION, int(agrees.sum()), _MIN_SAMPLED)
        return refine_relation(
            relation, pairs.select(agrees), _intrinsics(cameras), with_scale=with_scale
        ).earlier_from_later

    def _refine(
        self,
        relation: Floats,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        cameras: tuple[Camera, Camera],
        with_scale: bool,
    ) -> tuple[Relation, _Found]:
        """Landmarks found by the relation, and the relation that they give, twice."""
        for _ in range(2):
            found = self._find(relation, known, seen, cameras)
            squared = pair_errors(relation, found.pairs, _intrinsics(cameras))
            near = (squared < _MAX_NEAR) & (found.correlation > _MIN_CORRELATION)
            if near.sum() < _MIN_SAMPLED:
                return Relation(relation, squared, np.zeros((7, 7))), found
            refined = refine_relation(
                relation, found.pairs.select(near), _intrinsics(cameras), with_scale=with_scale
            )
            relation = refined.earlier_from_later
        squared = pair_errors(relation, found.pairs, _intrinsics(cameras))
        return Relation(relation, squared, refined.information), found

    def _find(
        self,
        relation: Floats,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        cameras: tuple[Camera, Camera],
    ) -> _Found:
        """Landmarks of the later keyframe where known ones are predicted."""
        view = in_view(sim3.inverse(relation), known, *cameras)
        query = FeatureSet(
            view.xy,
            predicted_octave(known.octave[view.rows], view.size, self._scale_factor),
            known.angle[view.rows],
            known.descriptor[view.rows],
        )
        radius = max(_SEARCH_RATIO * cameras[1].width, _MIN_SEARCH_PX)
        matches = self._matcher.match(
            query,
            _features(seen),
            Circles(np.full(len(query), radius)),
            ratio=1.0,
            check_rotation=False,
        )
        rows = view.rows[matches.query]
        pairs = self._pairs(known, seen, rows, matches.train, cameras)
        # Looks are compared only where positions may agree.
        near = pair_errors(relation, pairs, _intrinsics(cameras)) < _MAX_NEAR
        rows, later = rows[near], matches.train[near]
        warp = self._warps(relation, known, seen, rows, later, cameras)
        correlation = patch_correlation(known.patch[rows], seen.patch[later], warp)
        return _Found(rows, later, pairs.select(near), correlation)

    def _warps(
        self,
        relation: Floats,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        rows: Ints,
        later: Ints,
        cameras: tuple[Camera, Camera],
    ) -> Floats:
        """(n, 2, 2) earlier_from_later of steps in patches, of surfaces that face both cameras."""
        rotation = relation[:2, :2] / np.sqrt(max(abs(np.linalg.det(relation[:2, :2])), 1e-12))
        pixel = self._scale_factor ** (
            seen.octave[later].astype(np.float64) - known.octave[rows].astype(np.float64)
        )
        distance = np.linalg.norm(known.xyz[rows], axis=1)
        other = np.linalg.norm(seen.xyz[later], axis=1) * float(sim3.scale_of(relation))
        factor = pixel * other / distance * cameras[0].fx / cameras[1].fx
        return np.asarray(factor[:, None, None] * rotation)

    def _pairs(
        self,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        rows: Ints,
        later: Ints,
        cameras: tuple[Camera, Camera],
    ) -> LandmarkPairs:
        larger = np.maximum(known.octave[rows], seen.octave[later]).astype(np.float64)
        sigma = _SIGMA_FACTOR * self._sigma_px * self._scale_factor**larger
        return LandmarkPairs(
            known.xyz[rows],
            seen.xyz[later],
            observed_xy(known, rows, cameras[0]),
            seen.xy[later],
            known.sigma[rows],
            seen.sigma[later],
            sigma,
        )

    def _inliers(self, found: _Found, squared: Floats) -> Bools:
        return np.asarray((squared < _MAX_SQUARED) & (found.correlation > _MIN_CORRELATION))

    def _check(
        self,
        relation: Relation,
        found: _Found,
        inlier: Bools,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        cameras: tuple[Camera, Camera],
        with_scale: bool,
    ) -> Rejection | None:
        """The first test that the landmarks found do not pass."""
        count = int(inlier.sum())
        if count < _MIN_INLIERS:
            return Rejection(RejectionReason.FEW_INLIERS, count, _MIN_INLIERS)
        area = _area(found.pairs.later_xy[inlier], cameras[1])
        if area < _MIN_AREA:
            return Rejection(RejectionReason.SMALL_AREA, area, _MIN_AREA)
        ratio = self._seen_ratio(relation.earlier_from_later, found, inlier, known, seen, cameras)
        if ratio < _MIN_SEEN:
            return Rejection(RejectionReason.MISSING_LANDMARKS, ratio, _MIN_SEEN)
        apart = _distance_apart(relation.earlier_from_later, found.pairs.select(inlier))
        if apart > _MAX_APART:
            return Rejection(RejectionReason.FAR_APART, apart, _MAX_APART)
        covariance = _covariance(relation.information, with_scale)
        distance = float(np.median(np.linalg.norm(seen.xyz[found.later[inlier]], axis=1)))
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])) / distance
        if not sigma < _MAX_UNCERTAINTY:
            return Rejection(RejectionReason.UNCERTAIN, sigma, _MAX_UNCERTAINTY)
        return self._check_scale(relation, found.pairs.select(inlier), cameras, with_scale)

    def _seen_ratio(
        self,
        relation: Floats,
        found: _Found,
        inlier: Bools,
        known: KnownLandmarks,
        seen: KnownLandmarks,
        cameras: tuple[Camera, Camera],
    ) -> float:
        """Inliers relative to the landmarks that both keyframes should see, the mean of both."""
        expected = in_view(sim3.inverse(relation), known, *cameras).rows < known.own
        back = in_view(relation, seen, cameras[1], cameras[0])
        own = int((found.rows[inlier] < known.own).sum())
        first = own / max(int(expected.sum()), 1)
        second = int(inlier.sum()) / max(len(back.rows), 1)
        return 0.5 * (first + second)

    def _check_scale(
        self,
        relation: Relation,
        pairs: LandmarkPairs,
        cameras: tuple[Camera, Camera],
        with_scale: bool,
    ) -> Rejection | None:
        """Whether the scales may differ so much; those of two metric keyframes may not."""
        free = relation
        if not with_scale:
            free = refine_relation(
                relation.earlier_from_later, pairs, _intrinsics(cameras), with_scale=True
            )
        scale = float(sim3.scale_of(free.earlier_from_later))
        factor, limit = max(scale, 1.0 / scale), _MAX_SCALE if with_scale else _MAX_METRIC_SCALE
        if factor > limit:
            return Rejection(RejectionReason.IMPLAUSIBLE_SCALE, factor, limit)
        return None

    def _is_supported(
        self,
        relation: Floats,
        known: KnownLandmarks,
        later: Place,
        before: Place,
        cameras: tuple[Camera, Camera],
    ) -> bool:
        """Whether a keyframe before sees enough of the place where odometry has it."""
        moved = relation @ sim3.inverse(later.odom_from_cam) @ before.odom_from_cam
        seen = know_landmarks([before])
        if seen.own < _MIN_LANDMARKS:
            return False
        found = self._find(moved, known, seen, cameras)
        squared = pair_errors(moved, found.pairs, _intrinsics(cameras))
        return int(self._inliers(found, squared).sum()) >= _MIN_SUPPORT


def _features(landmarks: KnownLandmarks, count: int | None = None) -> FeatureSet:
    """The first `count` landmarks, or all, as features."""
    part = slice(count)
    return FeatureSet(
        landmarks.xy[part],
        landmarks.octave[part],
        landmarks.angle[part],
        landmarks.descriptor[part],
    )


def _intrinsics(cameras: tuple[Camera, Camera]) -> tuple[Intrinsics, Intrinsics]:
    first, second = (Intrinsics(c.fx, c.fy, c.cx, c.cy) for c in cameras)
    return first, second


def _area(xy: Floats, camera: Camera) -> float:
    """Ratio of the cells of the image that hold pixels."""
    column = np.clip(_CELLS * xy[:, 0] / camera.width, 0, _CELLS - 1).astype(np.int64)
    row = np.clip(_CELLS * xy[:, 1] / camera.height, 0, _CELLS - 1).astype(np.int64)
    return len(np.unique(row * _CELLS + column)) / _CELLS**2


def _distance_apart(relation: Floats, pairs: LandmarkPairs) -> float:
    """Distance of the keyframes relative to the median distance of the landmarks that agree.

    The smaller of that from both keyframes: down a street, much is also seen from far away.
    """
    from_earlier = float(np.median(np.linalg.norm(pairs.earlier, axis=1)))
    from_later = float(np.median(np.linalg.norm(pairs.later, axis=1)))
    nearer = min(from_earlier, from_later * float(sim3.scale_of(relation)))
    return float(np.linalg.norm(relation[:3, 3])) / nearer


def _covariance(information: Floats, with_scale: bool) -> Floats:
    """(7, 7) covariance of the relation, infinite if it is not determined."""
    size = 7 if with_scale else 6
    result = np.zeros((7, 7))
    try:
        inverse = np.linalg.inv(information[:size, :size])
    except np.linalg.LinAlgError:
        inverse = np.diag(np.full(size, np.inf))
    result[:size, :size] = _COVARIANCE_SCALE * inverse
    return result
