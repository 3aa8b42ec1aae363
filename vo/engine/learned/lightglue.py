"""Matches of two sets of features by a network: LightGlue, LighterGlue, SuperGlue.

Source: Lindenberger et al., "LightGlue: local feature matching at light speed", ICCV 2023.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vo.base.types import Floats, Floats32, Ints
from vo.engine.frontend.contracts import FeatureSet, Matcher, Matches, SearchRegion
from vo.engine.learned.inference import Inference

MIN_PROBABILITY = 0.1  # the authors' threshold

Assignment = Callable[[FeatureSet, FeatureSet], Floats | Floats32]
"""Logarithms (N, M) of the probability that two features, all with positions, belong together.

Raises ValueError where it is not given what it needs.
"""


def normalised(xy: Floats | Floats32, size: tuple[int, int]) -> Floats32:
    """Positions (N, 2), 0 in the middle of an image (width, height), 1 at half its longer side."""
    return ((xy - np.divide(size, 2.0)) / (max(size) / 2.0)).astype(np.float32)


def matches_of(log_assignment: Floats | Floats32, min_probability: float) -> Matches:
    """Pairs that are the most probable ones of both features; scores are 1 - probability.

    Args:
        log_assignment: (N, M) logarithms of the probability of each pair.
        min_probability: above which a pair is a match.
    """
    if 0 in log_assignment.shape:
        return Matches(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    train, query = log_assignment.argmax(axis=1), log_assignment.argmax(axis=0)
    every = np.arange(len(train))
    probability = np.exp(log_assignment[every, train].astype(np.float64))
    good = np.flatnonzero((query[train] == every) & (probability > min_probability))
    return Matches(good, train[good], 1.0 - probability[good])


class LightGlue:
    """The assignment of LightGlue and LighterGlue, see `Assignment`."""

    def __init__(self, network: Inference) -> None:
        self._network = network

    def __call__(self, query: FeatureSet, train: FeatureSet) -> Floats32:
        """See `Assignment`."""
        given = _inputs(query, 0) | _inputs(train, 1)
        (log_assignment,) = self._network.run(given, ["log_assignment"])
        return np.asarray(log_assignment[0])


class AssignmentMatcher:
    """Matches two images by a network; see `vo.engine.frontend.contracts.Matcher`.

    Within a search region, and where positions are not known, `near` matches by descriptors alone:
    the network compares how features lie to each other in whole images. Ratio and orientations
    are not used.
    """

    def __init__(self, assignment: Assignment, near: Matcher, min_probability: float) -> None:
        self._assignment = assignment
        self._near = near
        self._min_probability = min_probability

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        """One-to-one matches, see `vo.engine.frontend.contracts.Matcher`.

        Raises:
            ValueError: the size of an image is missing, or descriptors have another layout.
        """
        q, t = _placed(query), _placed(train)
        if region is not None or len(q) == 0 or len(t) == 0:
            return self._near.match(
                query, train, region, ratio=ratio, check_rotation=check_rotation
            )
        found = self._assignment(query.select(q), train.select(t))
        matches = matches_of(found, self._min_probability)
        return Matches(q[matches.query], t[matches.train], matches.score)


def _placed(features: FeatureSet) -> Ints:
    """Rows of the features with known positions."""
    if features.xy is None:
        return np.empty(0, np.int64)
    return np.flatnonzero(np.isfinite(features.xy).all(axis=1))


def _inputs(features: FeatureSet, side: int) -> dict[str, Floats32]:
    """Inputs of the network for one of the two images."""
    if features.size is None or features.xy is None:
        raise ValueError("features have no image size; matching by a network needs it")
    return {
        f"kpts{side}": normalised(features.xy, features.size)[None],
        f"desc{side}": np.ascontiguousarray(features.descriptor, np.float32)[None],
    }
