"""Features of a second kind where those of the first fail, so that they cost time only there.

A map has features of one kind at a time, and so have the frames that are tracked in it. Where a
frame cannot be tracked, those of the map are exchanged for the other kind, extracted from the
images of its keyframes, and the frame is tried again. If that fails too, they are put back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from vo.base.failures import Failure, FailureReason
from vo.base.types import Keypoints
from vo.engine.frontend.contracts import Matcher, PointDescriber, feature_set
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.map_features import (
    KeyframeFeatures,
    MapFeatures,
    exchange,
    features_of,
    joined,
)
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.tracking.tracker import Tracker

if TYPE_CHECKING:
    from vo.engine.features.second_kind import SecondKind

# Failures that other features may avert: those of their number, not those of the motion.
_AVERTABLE = (
    FailureReason.FEW_FEATURES,
    FailureReason.FEW_MATCHES,
    FailureReason.FEW_LANDMARKS,
    FailureReason.FEW_INLIERS,
)
_MIN_CONTRAST = 4.0  # grey levels; no network finds anything in a black image
# Matches of two keyframes from which features of the first kind are used again, in units of those
# that a first map needs.
_ENOUGH = 2


class Rescue:
    """Decides which kind of features a map has.

    Args:
        second: used where the first one fails; None if nothing is ever rescued.
        min_matches: matches that a first map needs.
    """

    def __init__(
        self,
        local_map: LocalMap,
        tracker: Tracker,
        matcher: Matcher,
        first: PointDescriber,
        second: SecondKind | None,
        min_matches: int,
    ) -> None:
        self._map = local_map
        self._tracker = tracker
        self._matcher = matcher
        self._first, self._second = first, second
        self._enough = _ENOUGH * min_matches
        # Features of the kind that the map does not have, extracted while tracking was lost.
        self._others: WeakKeyDictionary[Keyframe, KeyframeFeatures] = WeakKeyDictionary()
        self._before: Keypoints | None = None  # those of the first kind in the last keyframe

    def may_avert(self, failure: Failure) -> bool:
        """Whether features of another kind are there and may avert a failure."""
        return (
            self._second is not None and failure.reason in _AVERTABLE and self._second.is_usable()
        )

    def of_map(self, frame: PreprocessedFrame) -> PreprocessedFrame:
        """A frame with features of the kind that the map has."""
        if self._second is None:
            return frame
        return frame.of_kind(is_second=self._map.has_second_kind)

    def track(
        self, frame: PreprocessedFrame, failure: Failure
    ) -> tuple[PreprocessedFrame, TrackedFrame | Failure]:
        """Track a frame that has failed with the map's features with those of the other kind.

        Returns:
            The frame with features of the map's kind, and its pose or the failure before.
        """
        if self._second is None or frame.pyramid[-1].std() < _MIN_CONTRAST:
            return frame, failure
        if not self.may_avert(failure):
            return frame, failure
        last = self._tracker.last
        counts = self._map.visible.copy(), self._map.found.copy()
        before = self._exchange()
        if last is not None:
            self._tracker.last = last._replace(frame=self.of_map(last.frame))
        again = self.of_map(frame)
        tracked = self._tracker.track(again, None, is_lost=True)
        if isinstance(tracked, Failure):
            exchange(self._map, before)
            self._map.visible, self._map.found = counts
            self._tracker.last = last
            return frame, failure
        self._others.clear()
        self._before = None
        return again, tracked

    def at_keyframe(self, frame: PreprocessedFrame) -> PreprocessedFrame:
        """Go back to the first kind once it matches from one keyframe to the next; the frame."""
        if self._second is None or not self._map.has_second_kind:
            return frame
        before, self._before = self._before, frame.of_kind(is_second=False).keypoints
        if before is not None:
            matches = self._matcher.match(feature_set(before), feature_set(self._before))
            if len(matches.query) >= self._enough:
                self._others.clear()
                self._exchange()
                self._others.clear()
        return self.of_map(frame)

    def _exchange(self) -> MapFeatures:
        """Give the map features of the other kind; those that it had."""
        assert self._second is not None
        extractor = self._first if self._map.has_second_kind else self._second
        keyframes = self._map.keyframes
        for keyframe in keyframes:
            if keyframe not in self._others:
                self._others[keyframe] = features_of(self._map, keyframe, extractor)
        return exchange(self._map, joined(self._map, [self._others[k] for k in keyframes]))
