"""Loops, relocalisations and the use of a map, as they are reported."""

from __future__ import annotations

from collections.abc import Sequence

from vo.base.frozen import frozen

_CERTAIN = 10  # keyframes that agree on where two parts are: a stretch, of which no copy is known


@frozen()
class ClosedLoop:
    """An accepted loop, and the correction that followed.

    Attributes:
        kind: `loop` within a world, `marker` by a marker within a world, `merge` where it connected
            two segments, `repair` across frames where odometry was doubted and loops contradict it,
            `session` to a keyframe of the loaded map.
        earlier_frame: number of the earlier keyframe's frame, in the recording of its session.
        inliers: landmarks that agree; of a marker, keyframes that agree.
        corrected_from: first frame whose causal pose is corrected by it; None at the end of a run.
        correction_m: distance by which the later keyframe was moved in the map frame, in metres, or
            in units of the map; None for what connected two worlds.
        correction_deg: angle by which it was turned; None for what connected two worlds.
        earlier_session: number of the session in the loaded map; None for the run itself.
        marker: id of the marker that was seen again, None if the place was recognised.
    """

    kind: str
    frame: int
    earlier_frame: int
    segment: int
    earlier_segment: int
    inliers: int
    corrected_from: int | None
    correction_m: float | None
    correction_deg: float | None
    earlier_session: int | None = None
    marker: int | None = None

    @property
    def joins(self) -> bool:
        """Whether it joins what only the look of places connects: no odometry speaks for it."""
        return self.kind not in ("loop", "marker")

    @property
    def repairs(self) -> bool:
        """Whether it contradicts odometry, which was doubted in between."""
        return self.kind == "repair"


def are_doubtful(loops: Sequence[ClosedLoop]) -> bool:
    """Whether loops replace motions of odometry, or join parts by a few keyframes alone."""
    keyframes: dict[tuple[int | None, ...], int] = {}
    joined = set()
    for loop in loops:
        pair = loop.earlier_session, *sorted((loop.segment, loop.earlier_segment))
        keyframes[pair] = keyframes.get(pair, 0) + (1 if loop.marker is None else loop.inliers)
        if loop.joins:
            joined.add(pair)
    has_repairs = any(loop.repairs for loop in loops)
    return has_repairs or any(keyframes[pair] < _CERTAIN for pair in joined)


@frozen()
class Relocalisation:
    """A segment whose place in an older world was found while the camera was in it.

    A segment begins with a world of its own: after tracking was lost, or at the start of a run in a
    loaded map.

    Attributes:
        frame: first frame whose causal pose is in the older world.
        keyframe: number of the frame of the newest keyframe that was recognised.
        earlier_frame: number of the frame that it was recognised by, in its own recording.
        loops: number of keyframes that were recognised.
        inliers: landmarks that agree, of the newest of them.
        correction_m: distance by which the pose of `keyframe` changed, in metres or units of the
            map. Until then the segment was taken to begin where tracking was lost.
        correction_deg: angle by which it changed.
        earlier_session: number of the recording in the loaded map; None for the run itself.
    """

    frame: int
    segment: int
    keyframe: int
    earlier_frame: int
    loops: int
    inliers: int
    correction_m: float
    correction_deg: float
    earlier_session: int | None = None


@frozen()
class MapUse:
    """The loaded map of a run, and which segments were merged with it.

    Attributes:
        sessions: names of its recordings.
        met: segments of the run that are in the map's world, by the number of their first segment.
        metric_worlds: those of them, of one camera, whose lengths are metres by the map.
    """

    file: str
    sessions: tuple[str, ...]
    met: tuple[int, ...]
    metric_worlds: tuple[int, ...] = ()
