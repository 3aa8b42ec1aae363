"""Screening of candidates: refuses most of those that show another place, at a low cost."""

from __future__ import annotations

from vo.base.types import Camera
from vo.engine.loop_verification.landmark_search import LandmarkSearch, keyframe_pair
from vo.engine.loop_verification.relation import sample_relation
from vo.engine.places.records import Place
from vo.engine.places.vocabulary import Vocabulary

_DEPTH = 2  # of the nodes, of which there are 100
_SAMPLES = 150
# Landmarks that must agree with a relation: 99.7 % of the pairs that the verification accepts have
# as many, and 57 % of those that it refuses have not (docs/experiments/loop-verification.md).
_MIN_AGREEING = 6


class Screening:
    """Tells which candidates are worth a verification.

    Landmarks are compared only with those in the same node of the vocabulary.

    Source: Gálvez-López and Tardós, "Bags of binary words", 2012, sec. V-C (direct index).
    """

    def __init__(self, vocabulary: Vocabulary, scale_factor: float, *, seed: int = 0) -> None:
        self._vocabulary = vocabulary
        self._search = LandmarkSearch(scale_factor)
        self._seed = seed

    def passes(
        self, later: Place, earlier: Place, camera: Camera, earlier_camera: Camera | None = None
    ) -> bool:
        """Whether some landmarks of two keyframes agree with one relation of them."""
        pair = keyframe_pair(later, [earlier], camera, earlier_camera)
        nodes = (
            self._vocabulary.nodes_of(p.descriptor, _DEPTH) for p in (pair.earlier, pair.later)
        )
        pairs = self._search.by_node(pair, *nodes)
        if len(pairs.earlier) < _MIN_AGREEING:
            return False
        _, agrees = sample_relation(
            pairs,
            pair.intrinsics,
            camera.width,
            with_scale=pair.with_scale,
            seed=self._seed,
            samples=_SAMPLES,
        )
        return int(agrees.sum()) >= _MIN_AGREEING
