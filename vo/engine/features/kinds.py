"""Matching where features of two kinds occur, though never in one map at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.engine.frontend.contracts import FeatureSet, Matcher, Matches, SearchRegion


class MatcherOfKinds:
    """Matches binary descriptors with one matcher and all others with a second one.

    Args:
        binary: for descriptors of uint8.
        learned: for all others, of features without octaves.
    """

    def __init__(self, binary: Matcher, learned: Matcher) -> None:
        self._binary = binary
        self._learned = learned

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        """See `vo.engine.frontend.contracts.Matcher.match`."""
        if query.descriptor.dtype == np.uint8:
            return self._binary.match(
                query, train, region, ratio=ratio, check_rotation=check_rotation
            )
        # Landmarks change their octave where their patch is replaced by a larger or smaller one.
        query = replace(query, octave=np.zeros(len(query), np.int32))
        return self._learned.match(query, train, region, ratio=ratio, check_rotation=check_rotation)
