"""Search for the landmarks of one keyframe in another one, by a relation of the two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.config import MatchingConfig
from vo.base.frozen import frozen
from vo.base.geometry.projection import Intrinsics
from vo.base.types import Bools, Camera, Floats, Ints
from vo.engine.frontend.contracts import Circles, FeatureSet
from vo.engine.frontend.hamming_kernels import best_in_groups
from vo.engine.frontend.matching import HammingMatcher, agree_in_rotation, as_words
from vo.engine.geometry import sim3
from vo.engine.loop_verification.merged_landmarks import (
    MergedLandmarks,
    in_view,
    merge_landmarks,
    observed_xy,
)
from vo.engine.loop_verification.patch_comparison import patch_correlation
from vo.engine.loop_verification.relation import LandmarkPairs, pair_errors
from vo.engine.mapping.octaves import predicted_octave
from vo.engine.places.records import Place

_SEARCH_RATIO, _MIN_SEARCH_PX = 0.012, 5.0  # radius around predicted positions
_MIN_CORRELATION = 0.6
# Observations of two visits are of different landmarks at the same corner.
_SIGMA_FACTOR = 2.0


@frozen(eq=False)
class KeyframePair:
    """Landmarks of two compared keyframes, of the earlier one with those of its neighbours.

    Attributes:
        cameras: ideal (rectified) cameras of the earlier and the later keyframe.
        with_scale: whether their scales may differ, as one of them is not metric.
    """

    earlier: MergedLandmarks
    later: MergedLandmarks
    cameras: tuple[Camera, Camera]
    with_scale: bool

    @property
    def intrinsics(self) -> tuple[Intrinsics, Intrinsics]:
        """Those of the earlier and the later camera."""
        first, second = (Intrinsics(c.fx, c.fy, c.cx, c.cy) for c in self.cameras)
        return first, second


def keyframe_pair(
    later: Place, earlier: Sequence[Place], camera: Camera, earlier_camera: Camera | None = None
) -> KeyframePair:
    """A keyframe, and an earlier one with neighbours of it; arguments as of `LoopVerifier`."""
    return KeyframePair(
        merge_landmarks(earlier),
        merge_landmarks([later]),
        (earlier_camera or camera, camera),
        with_scale=not (later.is_metric and earlier[0].is_metric),
    )


class FoundLandmarks(NamedTuple):
    """Earlier landmarks (n,) found in the later keyframe."""

    earlier: Ints
    later: Ints
    pairs: LandmarkPairs

    def select(self, chosen: Bools) -> FoundLandmarks:
        """Some of the landmarks."""
        return FoundLandmarks(self.earlier[chosen], self.later[chosen], self.pairs.select(chosen))


class LandmarkSearch:
    """Searches by descriptors, and compares patches."""

    def __init__(self, scale_factor: float, sigma_px: float = 0.5) -> None:
        self._scale_factor = scale_factor
        self._sigma_px = sigma_px
        self._config = MatchingConfig()
        self._matcher = HammingMatcher(self._config)

    def by_descriptor(self, pair: KeyframePair, count: int) -> LandmarkPairs:
        """The first `count` earlier landmarks matched with the later ones, without a relation."""
        matches = self._matcher.match(_features(pair.earlier, count), _features(pair.later))
        return self._pairs(pair, matches.query, matches.train)

    def by_node(self, pair: KeyframePair, earlier: Ints, later: Ints) -> LandmarkPairs:
        """Landmarks matched within nodes (M,) and (N,) of the vocabulary, without a relation."""
        matched, _ = best_in_groups(
            as_words(pair.earlier.descriptor),
            earlier,
            as_words(pair.later.descriptor),
            later,
            self._config.max_hamming,
            self._config.ratio,
        )
        rows = np.flatnonzero(matched >= 0)
        kept = agree_in_rotation(pair.earlier.angle[rows], pair.later.angle[matched[rows]])
        return self._pairs(pair, rows[kept], matched[rows[kept]])

    def by_relation(
        self, pair: KeyframePair, earlier_from_later: Floats, max_squared: float
    ) -> FoundLandmarks:
        """Earlier landmarks found in the later image near where a relation predicts them.

        Their patches correlate, and their squared errors are below a limit.
        """
        earlier, later = pair.earlier, pair.later
        view = in_view(sim3.inverse(earlier_from_later), earlier.xyz, *pair.cameras)
        query = FeatureSet(
            view.xy,
            predicted_octave(earlier.octave[view.rows], view.size, self._scale_factor),
            earlier.angle[view.rows],
            earlier.descriptor[view.rows],
        )
        radius = max(_SEARCH_RATIO * pair.cameras[1].width, _MIN_SEARCH_PX)
        circles = Circles(np.full(len(query), radius))
        matches = self._matcher.match(
            query, _features(later), circles, ratio=1.0, check_rotation=False
        )
        rows, later_rows = view.rows[matches.query], matches.train
        found = FoundLandmarks(rows, later_rows, self._pairs(pair, rows, later_rows))
        # Patches are compared only where positions may agree.
        found = agreeing(pair, found, earlier_from_later, max_squared)
        warp = self._warps(pair, earlier_from_later, found.earlier, found.later)
        patches = earlier.patch[found.earlier], later.patch[found.later]
        return found.select(patch_correlation(*patches, warp) > _MIN_CORRELATION)

    def _pairs(self, pair: KeyframePair, rows: Ints, later_rows: Ints) -> LandmarkPairs:
        earlier, later = pair.earlier, pair.later
        larger = np.maximum(earlier.octave[rows], later.octave[later_rows]).astype(np.float64)
        sigma = _SIGMA_FACTOR * self._sigma_px * self._scale_factor**larger
        return LandmarkPairs(
            earlier.xyz[rows],
            later.xyz[later_rows],
            observed_xy(earlier, rows, pair.cameras[0]),
            later.xy[later_rows],
            earlier.sigma[rows],
            later.sigma[later_rows],
            sigma,
        )

    def _warps(self, pair: KeyframePair, relation: Floats, rows: Ints, later_rows: Ints) -> Floats:
        """(n, 2, 2) earlier_from_later of steps in patches, of surfaces that face both cameras."""
        earlier, later = pair.earlier, pair.later
        rotation = relation[:2, :2] / np.sqrt(max(abs(np.linalg.det(relation[:2, :2])), 1e-12))
        pixel = self._scale_factor ** (
            later.octave[later_rows].astype(np.float64) - earlier.octave[rows].astype(np.float64)
        )
        distance = np.linalg.norm(earlier.xyz[rows], axis=1)
        other = np.linalg.norm(later.xyz[later_rows], axis=1) * float(sim3.scale_of(relation))
        factor = pixel * other / distance * pair.cameras[0].fx / pair.cameras[1].fx
        return np.asarray(factor[:, None, None] * rotation)


def agreeing(
    pair: KeyframePair, found: FoundLandmarks, earlier_from_later: Floats, max_squared: float
) -> FoundLandmarks:
    """The landmarks found whose squared errors are below a limit."""
    return found.select(pair_errors(earlier_from_later, found.pairs, pair.intrinsics) < max_squared)


def _features(landmarks: MergedLandmarks, count: int | None = None) -> FeatureSet:
    """The first `count` landmarks, or all, as features."""
    part = slice(count)
    return FeatureSet(
        landmarks.xy[part],
        landmarks.octave[part],
        landmarks.angle[part],
        landmarks.descriptor[part],
    )
