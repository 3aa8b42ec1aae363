"""The loops of a run: each in one record, from its verification to what is reported of it."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.records.closed_loops import ClosedLoop, Relocalisation
from vo.base.types import Floats
from vo.engine.mapping.keyframe import FrameId
from vo.engine.memory.run_in_map import RunInMap
from vo.engine.places.records import Loop, PlaceKey, RegisteredKeyframes
from vo.engine.trajectory.store import TrajectoryStore

_MIN_JOINING = 3  # keyframes of one segment with loops to others, fewer of which never join them


@dataclass(eq=False)
class LoopRecord:
    """A loop, and what has become of it.

    Attributes:
        earlier: frame of its earlier keyframe, of the run or of the loaded map.
        session: number of the session of the loaded map; None for the run itself.
        is_judged: whether a result of the pose graph had it.
        is_accepted: whether the newest result has accepted it.
        was_accepted: whether any has.
        connects: whether it was accepted as the first one between two worlds.
        pose_before: (4, 4) of the later keyframe before it was accepted.
        report: what is reported while it is accepted.
    """

    loop: Loop
    later: FrameId
    earlier: FrameId
    session: int | None
    is_judged: bool = False
    is_accepted: bool = False
    was_accepted: bool = False
    connects: bool = False
    pose_before: Floats | None = None
    report: ClosedLoop | None = None

    def joins(self, segment: int) -> bool:
        """Whether it is from a segment to another one."""
        is_elsewhere = self.session is not None or self.earlier.segment != segment
        return self.later.segment == segment and is_elsewhere


class LoopLedger:
    """Keeps the loops of a run, judges them by results of the pose graph, and reports them.

    Attributes:
        frames: of the keyframes of the run that are in the graph.
        records: of all loops, in the order in which they were found.
    """

    def __init__(self, store: TrajectoryStore, in_map: RunInMap) -> None:
        self.frames: dict[PlaceKey, FrameId] = {}
        self.records: list[LoopRecord] = []
        self._store = store
        self._in_map = in_map
        self._submitted: list[LoopRecord] = []  # those of the graph that is optimised
        self._new: list[LoopRecord] = []  # accepted since the last frame
        self._was_apart = False  # the segment of the newest frame, before the newest result
        self._relocalisations: list[Relocalisation] = []
        self._found: Relocalisation | None = None  # by which no frame has been placed yet

    @property
    def loops(self) -> list[Loop]:
        """All loops."""
        return [record.loop for record in self.records]

    @property
    def accepted(self) -> list[Loop]:
        """Loops that the newest result of the pose graph has accepted."""
        return [record.loop for record in self.records if record.is_accepted]

    @property
    def closed_loops(self) -> tuple[ClosedLoop, ...]:
        """What is reported of these."""
        return tuple(record.report for record in self.records if record.report is not None)

    @property
    def relocalisations(self) -> tuple[Relocalisation, ...]:
        """Segments whose place in an older world was found while the camera was in them."""
        return tuple(self._relocalisations)

    def add(self, loops: Sequence[Loop]) -> None:
        """Add verified loops between keyframes that are known."""
        for loop in loops:
            in_map = self._in_map.frame(loop.earlier)
            session = None if in_map is None else loop.earlier.session
            earlier = in_map or self.frames[loop.earlier]
            self.records.append(LoopRecord(loop, self.frames[loop.later], earlier, session))

    def forget_from(self, frame_index: int) -> tuple[PlaceKey, ...]:
        """Forget the keyframes from a frame on, which are returned, and their loops."""
        gone = tuple(key for key, frame in self.frames.items() if frame.index >= frame_index)
        for key in gone:
            del self.frames[key]
        self.records = [each for each in self.records if each.loop.later in self.frames]
        self._submitted = []
        self._relocalisations = [r for r in self._relocalisations if r.frame < frame_index]
        self._found = None
        return gone

    def begin_frame(self, index: int, segment: int) -> None:
        """Note the first frame whose pose is as it was corrected."""
        for record in self._new:
            if record.report is not None:
                record.report = replace(record.report, corrected_from=index)
        if self._found is not None and self._found.segment == segment:
            self._relocalisations.append(replace(self._found, frame=index))
        self._new, self._found = [], None

    def is_apart(self, segment: int) -> bool:
        """Whether nothing connects a segment with an older world."""
        return self._in_map.has_older(segment, self._store.world(segment))

    def joins_enough(self, segment: int) -> bool:
        """Whether enough keyframes of a segment have loops to others to be connected with them."""
        joining = (each.loop.support for each in self.records if each.joins(segment))
        return sum(joining) >= _MIN_JOINING

    def has_new(self, segment: int) -> bool:
        """Whether there are loops that no graph had, or enough of them to connect the segment."""
        waits = self.is_apart(segment) and not self.joins_enough(segment)
        new = (each for each in self.records if not each.is_judged)
        return any(not (waits and each.joins(segment)) for each in new)

    @property
    def has_unjudged(self) -> bool:
        """Whether there are loops that no graph had."""
        return any(not each.is_judged for each in self.records)

    def submit(self) -> list[Loop]:
        """The loops for a graph, whose result `judge` takes."""
        self._submitted = list(self.records)
        return self.loops

    def judge(
        self, registered: RegisteredKeyframes, segment: int, *, keeps_all: bool
    ) -> list[Loop]:
        """Note which loops a result accepts; those whose worlds are to be placed by it.

        Args:
            registered: the result, before it is applied to the path.
            segment: of the newest frame.
            keeps_all: whether worlds are placed anew for all loops that were accepted once, else
                for those that were accepted until now, or are.
        """
        rejected = {_identity(loop) for loop in registered.rejected}
        for record in self._submitted:
            record.is_judged = True
            record.is_accepted = _identity(record.loop) not in rejected
            record.was_accepted |= record.is_accepted
            if record.is_accepted and record.report is None:
                record.pose_before = self._pose(record)
                record.connects = self._connects(record)
        self._submitted = []
        self._was_apart = self.is_apart(segment)
        return [
            each.loop
            for each in self.records
            if each.is_accepted or each.report is not None or (keeps_all and each.was_accepted)
        ]

    def report(self, wrong: Collection[PlaceKey], segment: int) -> None:
        """Note what the result has changed, after it was applied to the path.

        Args:
            wrong: keyframes whose motion since the one before loops have shown to be wrong.
            segment: of the newest frame.
        """
        new = [each for each in self.records if each.is_accepted and each.report is None]
        for record in self.records:
            if not record.is_accepted:
                record.report = None
        for record in new:
            record.report = self._report(record, wrong)
        self._new += new
        kept = [r for r in self._relocalisations if not self.is_apart(r.segment)]
        self._relocalisations = kept
        if self._was_apart and not self.is_apart(segment):
            self._found = self._relocalisation([each for each in new if each.joins(segment)])

    def _report(self, record: LoopRecord, wrong: Collection[PlaceKey]) -> ClosedLoop:
        loop = record.loop
        kind = "loop" if loop.marker is None else "marker"
        correction = None if record.connects else self._correction(record)
        if correction is None:
            kind = "merge"
        elif any(loop.earlier < key <= loop.later for key in wrong):
            kind = "repair"
        return ClosedLoop(
            kind=kind if record.session is None else "session",
            frame=record.later.index,
            earlier_frame=record.earlier.index,
            segment=record.later.segment,
            earlier_segment=record.earlier.segment,
            inliers=loop.inliers,
            corrected_from=None,
            correction_m=None if correction is None else correction[0],
            correction_deg=None if correction is None else correction[1],
            earlier_session=record.session,
            marker=loop.marker,
        )

    def _relocalisation(self, joining: Sequence[LoopRecord]) -> Relocalisation | None:
        """The relocalisation by new loops from the segment of the newest frame to another one."""
        if not joining:  # it is connected by loops of others to it
            return None
        newest = max(joining, key=lambda each: each.later.index)
        correction_m, correction_deg = self._correction(newest)
        return Relocalisation(
            frame=-1,
            segment=newest.later.segment,
            keyframe=newest.later.index,
            earlier_frame=newest.earlier.index,
            loops=len(joining),
            inliers=newest.loop.inliers,
            correction_m=correction_m,
            correction_deg=correction_deg,
            earlier_session=newest.session,
        )

    def _connects(self, record: LoopRecord) -> bool:
        """Whether a loop connects worlds that were not connected before."""
        later = self._store.world(record.later.segment)
        if record.session is not None:
            return later not in self._in_map.met
        return later != self._store.world(record.earlier.segment)

    def _pose(self, record: LoopRecord) -> Floats:
        (pose,) = self._store.keyframes_by_id([record.loop.later.keyframe])
        return pose.world_from_cam0

    def _correction(self, record: LoopRecord) -> tuple[float, float]:
        """By how many metres and degrees its later keyframe has moved."""
        assert record.pose_before is not None
        change = inverse(record.pose_before) @ self._pose(record)
        return float(np.linalg.norm(change[:3, 3])), math.degrees(rotation_angle(change[:3, :3]))


def _identity(loop: Loop) -> tuple[PlaceKey, PlaceKey, int | None]:
    return loop.earlier, loop.later, loop.marker
