"""Loops by markers that are seen again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.geometry import sim3
from vo.geometry.transforms import inverse
from vo.mapping.keyframe import FrameId
from vo.markers.marker_problem import MarkerView
from vo.markers.visit_fit import VisitPose, fit_visit
from vo.places.records import Loop, Place, PlaceKey
from vo.types import Floats

_MAX_GAP_NS = 2_000_000_000  # between two keyframes of one visit
_MAX_USED_NS = 5_000_000_000  # from the begin of a visit, in which the path drifts little
# Keyframes of a visit, so that a wrong id, or a wrong one of both poses of a square, is noticed.
# One camera needs three for its scale.
_MIN_METRIC, _MIN_MONO = 2, 3


class _Sight(NamedTuple):
    """A marker in a stored keyframe."""

    key: PlaceKey
    frame: FrameId
    odom_from_cam: Floats
    view: MarkerView


class _Visit(NamedTuple):
    """A marker in consecutive keyframes of a segment."""

    first: _Sight
    last: _Sight
    keyframes: int
    pose: VisitPose


class MarkerLoops:
    """Connects the visits of each marker.

    A visit lasts until a marker is not seen for two seconds, or the segment ends. The keyframes of
    its first five seconds together give the pose of the marker relative to the first of them, and
    two visits give the relation of their first keyframes. In a path of one camera a visit must show
    its scale as well: then the marker is a frame in metres for both.

    Args:
        cam0_from_rectified: (4, 4) rotation of the rectified camera.
        is_metric: whether the path is in metres.
    """

    def __init__(self, cam0_from_rectified: Floats, *, is_metric: bool) -> None:
        self._rectified_from_cam0 = inverse(cam0_from_rectified)
        self._is_metric = is_metric
        self._seen: dict[int, tuple[MarkerView, ...]] = {}  # by frame, until it is stored
        self._open: dict[int, list[_Sight]] = {}  # the visit that goes on, by id
        self._visits: dict[int, list[_Visit]] = {}  # those before, by id
        self._repeated: set[int] = set()
        self._refused: list[Loop] = []

    @property
    def repeated(self) -> tuple[int, ...]:
        """Ids that one image has shown twice: none of their loops can be trusted."""
        return tuple(sorted(self._repeated))

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence for each marker that odometry contradicts."""
        starts = [visit.first for visits in self._visits.values() for visit in visits]
        frames = {start.key: start.frame for start in starts}
        ends: dict[int, list[int]] = {}
        for loop in self._refused:
            both = [frames[key] for key in (loop.earlier, loop.later) if key in frames]
            if loop.marker is not None and len({frame.segment for frame in both}) == 1:
                ends.setdefault(loop.marker, []).extend(frame.index for frame in both)
        return tuple(
            f"marker {number} closes no loop, as it is not where the path expects it between "
            f"frames {min(seen)} and {max(seen)}: it was moved, two markers have this id, or the "
            "path is wrong"
            for number, seen in sorted(ends.items())
            if number not in self._repeated
        )

    def see(self, frame_index: int, views: Sequence[MarkerView], repeated: Sequence[int]) -> None:
        """Take what a frame shows; it is used if the frame is a keyframe.

        Args:
            frame_index: number of the frame.
            views: of markers whose id it shows once.
            repeated: ids that it shows several times.
        """
        self._repeated.update(repeated)
        clear = tuple(view for view in views if not view.is_ambiguous)
        if clear:
            self._seen[frame_index] = clear

    def add(self, place: Place) -> list[Loop]:
        """Take a keyframe that is stored; the loops by visits that have ended before it."""
        ended = [
            number
            for number, sights in self._open.items()
            if sights[0].frame.segment != place.frame.segment
            or place.frame.stamp_ns - sights[-1].frame.stamp_ns > _MAX_GAP_NS
        ]
        loops = [loop for number in ended for loop in self._end_visit(number)]
        for view in self._seen.get(place.frame.index, ()):
            sight = _Sight(place.key, place.frame, place.odom_from_cam, view)
            self._open.setdefault(view.id, []).append(sight)
        self._seen = {n: views for n, views in self._seen.items() if n > place.frame.index}
        return loops

    def finish(self) -> list[Loop]:
        """The loops by visits that have not ended yet, at the end of the run."""
        return [loop for number in tuple(self._open) for loop in self._end_visit(number)]

    def refuse(self, loops: Sequence[Loop]) -> None:
        """Note the loops that the pose graph takes for false now; those before are forgotten."""
        self._refused = [loop for loop in loops if loop.marker is not None]

    def needs(self, key: PlaceKey) -> bool:
        """Whether a keyframe may become an end of a loop."""
        starts = [sights[0] for sights in self._open.values()]
        starts += [visit.first for visits in self._visits.values() for visit in visits]
        return any(start.key == key for start in starts)

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew."""
        for number, sights in self._open.items():
            self._open[number] = [each for each in sights if each.frame.index < frame_index]
        self._open = {number: sights for number, sights in self._open.items() if sights}
        for number, visits in self._visits.items():
            self._visits[number] = [each for each in visits if each.last.frame.index < frame_index]

    def _end_visit(self, number: int) -> list[Loop]:
        """Loops of the visit of a marker that goes on, which ends."""
        sights = self._open.pop(number)
        if number in self._repeated or len(sights) < (
            _MIN_METRIC if self._is_metric else _MIN_MONO
        ):
            return []
        poses = np.stack([each.odom_from_cam for each in sights]) @ self._rectified_from_cam0
        found = fit_visit([each.view for each in sights], poses, is_metric=self._is_metric)
        if found is None:
            return []
        pose = found._replace(cam_from_marker=self._rectified_from_cam0 @ found.cam_from_marker)
        visit = _Visit(sights[0], sights[-1], len(sights), pose)
        before = self._visits.setdefault(number, [])
        partners = _partners(visit, before)
        before.append(visit)
        return [self._loop(number, each, visit) for each in partners]

    def _loop(self, number: int, earlier: _Visit, later: _Visit) -> Loop:
        """Of poses A and B of the marker, each with an error in its frame: A B^-1."""
        to_marker = sim3.inverse(later.pose.cam_from_marker)
        relation = earlier.pose.cam_from_marker @ to_marker
        to_later = sim3.adjoint(later.pose.cam_from_marker)
        covariance = to_later @ (earlier.pose.covariance + later.pose.covariance) @ to_later.T
        scale = 1.0 if self._is_metric else float(sim3.scale_of(relation))
        ends = earlier.first.key, later.first.key
        return Loop(
            *ends, sim3.rigid_part(relation), scale, covariance, later.keyframes, marker=number
        )


def _partners(visit: _Visit, before: Sequence[_Visit]) -> list[_Visit]:
    """Visits to be connected with one: the first and the newest in its segment and in others."""
    segment = visit.first.frame.segment
    same = [each for each in before if each.first.frame.segment == segment]
    others = [each for each in before if each.first.frame.segment != segment]
    return [*same[:1], *same[1:][-1:], *others[:1], *others[1:][-1:]]
