"""Overlap of outlines, and tracks: reports of several frames that are of one instance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vo.base.types import Floats
from vo.tools.objects.stored_objects import FoundObject

_SAME_OBJECT, _OTHER_OBJECT = 0.2, 0.5  # overlap from which two reports exclude each other


def overlap(a: Floats, b: Floats) -> float:
    """Intersection over union of the convex hulls of two outlines (M, 2)."""
    first, second = (cv2.convexHull(each.astype(np.float32)) for each in (a, b))
    areas = cv2.contourArea(first), cv2.contourArea(second)
    common = float(cv2.intersectConvexConvex(first, second)[0])
    union = areas[0] + areas[1] - common
    return common / union if union > 0 else 0.0


def without_overlaps(found: Sequence[FoundObject]) -> list[int]:
    """Rows of the instances that do not lie on a better one, the most confident first.

    Of two objects that look the same, and of two parts of one object, the better one is kept.
    """
    kept: list[int] = []
    order = sorted(range(len(found)), key=lambda n: (-found[n].confidence, -found[n].inliers, n))
    for n in order:
        if all(
            overlap(found[n].outline, found[k].outline) < _limit(found[n], found[k]) for k in kept
        ):
            kept.append(n)
    return kept


def _limit(a: FoundObject, b: FoundObject) -> float:
    return _SAME_OBJECT if a.name == b.name else _OTHER_OBJECT


_MIN_OVERLAP = 0.1
_MAX_GAP = 15  # frames that an instance may be hidden


@dataclass
class Track:
    """An instance through a recording."""

    id: int  # from 0
    name: str
    first: int  # number of the first frame
    last: int  # number of the last frame
    frames: int
    confidence: float
    outline: Floats  # (M, 2) in the last frame


class ObjectTracker:
    """Gives the same id to reports of the same instance."""

    def __init__(self) -> None:
        self.tracks: list[Track] = []
        self._before: list[int] = []  # frames that were searched

    def update(self, frame: int, found: Sequence[FoundObject]) -> list[int]:
        """The id of each report of a frame.

        `frame`: its number, larger than that before.
        """
        oldest = self._before[-_MAX_GAP] if len(self._before) >= _MAX_GAP else -1
        self._before.append(frame)
        alive = [track for track in self.tracks if track.last >= oldest]
        pairs = [
            (_nearness(track, each), track.id, n)
            for n, each in enumerate(found)
            for track in alive
            if track.name == each.name
        ]
        ids: dict[int, int] = {}
        for _, track_id, n in sorted(pairs, key=lambda pair: (-pair[0], *pair[1:])):
            if n not in ids and track_id not in ids.values():
                ids[n] = track_id
        for n, each in enumerate(found):
            if n not in ids:
                ids[n] = len(self.tracks)
                self.tracks.append(Track(ids[n], each.name, frame, frame, 0, 0.0, each.outline))
            track = self.tracks[ids[n]]
            track.last = frame
            track.frames += 1
            track.confidence = max(track.confidence, each.confidence)
            track.outline = each.outline
        return [ids[n] for n in range(len(found))]


def _nearness(track: Track, found: FoundObject) -> float:
    """Overlap with the last outline; without any, minus the distance of the centres."""
    common = overlap(track.outline, found.outline)
    if common >= _MIN_OVERLAP:
        return common
    return -float(np.linalg.norm(track.outline.mean(axis=0) - found.outline.mean(axis=0)))
