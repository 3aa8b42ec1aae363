"""Loops by markers that are seen again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.geometry import sim3
from vo.engine.mapping.keyframe import FrameId
from vo.engine.markers.dictionaries import is_same_kind
from vo.engine.places.records import Loop, MarkerVisit, PathKeyframe, PlaceKey

if TYPE_CHECKING:
    from vo.engine.markers.marker_problem import MarkerView

_MAX_GAP_NS = 2_000_000_000  # between two keyframes of one visit
# Keyframes of a visit, so that a wrong id, or a wrong one of both poses of a square, is noticed.
# One camera needs three for its scale.
_MIN_METRIC, _MIN_MONO = 2, 3
_MIN_JOINING = 3  # keyframes, fewer of which never join a segment with the map
_MAX_LENGTH_ERROR = 0.01  # of a marker in the map and the run, relative


class _Sight(NamedTuple):
    """A marker in a stored keyframe."""

    key: PlaceKey
    frame: FrameId
    odom_from_cam: Floats
    view: MarkerView


class _Visit(NamedTuple):
    """A marker in consecutive keyframes of a segment; pose and frame are those of the first.

    Attributes:
        last_index: number of the last frame, None for a visit of the loaded map.
    """

    marker: MarkerVisit
    frame: FrameId
    last_index: int | None

    @property
    def path(self) -> tuple[int, int]:
        """Session and segment."""
        return self.marker.key.session, self.frame.segment


class MarkerLoops:
    """Connects the visits of each marker.

    A visit lasts until a marker is not seen for two seconds, or the segment ends. Its keyframes
    together give the pose of the marker relative to the first of them, and two visits give the
    relation of their first keyframes. In a path of one camera a visit must show
    its scale as well: then the marker is a frame in metres for both. Visits of a loaded map are
    earlier ones.
    """

    def __init__(
        self,
        cam0_from_rectified: Floats,
        loaded: Sequence[tuple[MarkerVisit, FrameId]] = (),
        *,
        is_metric: bool,
    ) -> None:
        self._rectified_from_cam0 = inverse(cam0_from_rectified)
        self._is_metric = is_metric
        self._seen: dict[int, tuple[MarkerView, ...]] = {}  # by frame, until it is stored
        self._open: dict[int, list[_Sight]] = {}  # the visit that goes on, by id
        self._visits: dict[int, list[_Visit]] = {}  # those before, by id
        self._repeated: set[int] = set()
        self._refused: list[Loop] = []
        self._unlike: dict[int, tuple[MarkerVisit, MarkerVisit]] = {}  # of the map and of the run
        for marker, frame in loaded:
            self._visits.setdefault(marker.id, []).append(_Visit(marker, frame, None))

    @property
    def known(self) -> list[MarkerVisit]:
        """The first and the newest visit of each marker in each segment, for a map.

        Those of which an image has shown two, or that loops have shown to be moved, are left out.
        """
        doubted = {*self._repeated, *self._contradicted}
        found: list[MarkerVisit] = []
        for number, visits in sorted(self._visits.items()):
            if number in doubted:
                continue
            for path in sorted({visit.path for visit in visits}):
                of_path = [visit.marker for visit in visits if visit.path == path]
                found += [*of_path[:1], *of_path[1:][-1:]]
        return found

    @property
    def repeated(self) -> tuple[int, ...]:
        """Ids that one image has shown twice: none of their loops can be trusted."""
        return tuple(sorted(self._repeated))

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence for each marker that odometry, the map, or other markers contradict."""
        within = tuple(
            f"marker {number} closes no loop, as it is not where the path expects it between "
            f"frames {min(seen)} and {max(seen)}: it was moved, two markers have this id, or the "
            "path is wrong"
            for number, seen in sorted(self._contradicted.items())
            if number not in self._repeated and seen
        )
        of_map = tuple(
            f"marker {number} of the map is not used, as places or other markers contradict it: "
            "it was moved, or two markers have this id"
            for number, seen in sorted(self._contradicted.items())
            if number not in self._repeated and not seen
        )
        unlike = tuple(
            f"marker {number} of the map is not used: it is of {old.dictionary} with sides of "
            f"{old.length_m:g} m, and that of this run of {new.dictionary} with {new.length_m:g} m"
            for number, (old, new) in sorted(self._unlike.items())
        )
        return within + of_map + unlike

    @property
    def _contradicted(self) -> dict[int, list[int]]:
        """Markers of refused loops; the frames at their ends, none for loops to the map."""
        visits = [visit for visits in self._visits.values() for visit in visits]
        at = {visit.marker.key: visit for visit in visits}
        ends: dict[int, list[int]] = {}
        for loop in self._refused:
            both = [at[key] for key in (loop.earlier, loop.later) if key in at]
            if loop.marker is None or not both:
                continue
            if len({visit.path for visit in both}) == 1:
                ends.setdefault(loop.marker, []).extend(visit.frame.index for visit in both)
            elif both[0].last_index is None and loop.support >= _MIN_JOINING:
                ends.setdefault(loop.marker, [])
        return ends

    def see(self, frame_index: int, views: Sequence[MarkerView], repeated: Sequence[int]) -> None:
        """Take the markers that a frame shows once, and repeated ids; used if it is a keyframe."""
        self._repeated.update(repeated)
        clear = tuple(view for view in views if not view.is_ambiguous)
        if clear:
            self._seen[frame_index] = clear

    def add(self, keyframe: PathKeyframe) -> list[Loop]:
        """Take the next keyframe of the path; the loops by visits that have ended before it."""
        ended = [
            number
            for number, sights in self._open.items()
            if sights[0].frame.segment != keyframe.frame.segment
            or keyframe.frame.stamp_ns - sights[-1].frame.stamp_ns > _MAX_GAP_NS
        ]
        loops = [loop for number in ended for loop in self._end_visit(number)]
        for view in self._seen.get(keyframe.frame.index, ()):
            sight = _Sight(keyframe.key, keyframe.frame, keyframe.odom_from_cam, view)
            self._open.setdefault(view.id, []).append(sight)
        self._seen = {n: views for n, views in self._seen.items() if n > keyframe.frame.index}
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
        keys = [start.key for start in starts]
        keys += [visit.marker.key for visits in self._visits.values() for visit in visits]
        return key in keys

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew."""
        for number, sights in self._open.items():
            self._open[number] = [each for each in sights if each.frame.index < frame_index]
        self._open = {number: sights for number, sights in self._open.items() if sights}
        for number, visits in self._visits.items():
            self._visits[number] = [
                visit
                for visit in visits
                if visit.last_index is None or visit.last_index < frame_index
            ]

    def _end_visit(self, number: int) -> list[Loop]:
        """Loops of the visit of a marker that goes on, which ends."""
        sights = self._open.pop(number)
        if number in self._repeated or len(sights) < (
            _MIN_METRIC if self._is_metric else _MIN_MONO
        ):
            return []
        from vo.engine.markers.visit_fit import fit_visit

        poses = np.stack([each.odom_from_cam for each in sights]) @ self._rectified_from_cam0
        found = fit_visit([each.view for each in sights], poses, is_metric=self._is_metric)
        if found is None:
            return []
        first, view = sights[0], sights[0].view
        pose = self._rectified_from_cam0 @ found.cam_from_marker
        marker = MarkerVisit(
            *(first.key, number, view.dictionary, view.length_m),
            *(pose, found.covariance, len(sights)),
        )
        visit = _Visit(marker, first.frame, sights[-1].frame.index)
        before = self._visits.setdefault(number, [])
        unlike = [each for each in before if not _is_alike(each.marker, marker)]
        if unlike:
            self._unlike[number] = unlike[0].marker, marker
        partners = _partners(visit, [each for each in before if _is_alike(each.marker, marker)])
        before.append(visit)
        return [self._loop(each.marker, marker) for each in partners]

    def _loop(self, earlier: MarkerVisit, later: MarkerVisit) -> Loop:
        """Of poses A and B of the marker, each with an error in its frame: A B^-1."""
        relation = earlier.cam_from_marker @ sim3.inverse(later.cam_from_marker)
        to_later = sim3.adjoint(later.cam_from_marker)
        covariance = to_later @ (earlier.covariance + later.covariance) @ to_later.T
        scale = 1.0 if self._is_metric else float(sim3.scale_of(relation))
        ends = earlier.key, later.key
        return Loop(
            *ends, sim3.rigid_part(relation), scale, covariance, later.keyframes, marker=later.id
        )


def _partners(visit: _Visit, before: Sequence[_Visit]) -> list[_Visit]:
    """Visits to be connected with one: the first and the newest in its segment and in others."""
    same = [each for each in before if each.path == visit.path]
    others = [each for each in before if each.path != visit.path]
    return [*same[:1], *same[1:][-1:], *others[:1], *others[1:][-1:]]


def _is_alike(first: MarkerVisit, second: MarkerVisit) -> bool:
    """Whether two markers with the same id may be one."""
    error = abs(first.length_m / second.length_m - 1.0)
    return error <= _MAX_LENGTH_ERROR and is_same_kind(first.dictionary, second.dictionary)
