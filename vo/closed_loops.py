"""Loops that were closed, as they are reported."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClosedLoop:
    """A place that was seen again, and what the pose graph made of it.

    Attributes:
        kind: `loop` within a world, `merge` where it connected two segments.
        frame: number of the later keyframe's frame.
        earlier_frame: number of the earlier keyframe's frame.
        segment: of the later frame.
        earlier_segment: of the earlier frame.
        inliers: landmarks that agree.
        corrected_from: first frame whose causal pose is corrected by it; None at the end of a run.
        correction_m: distance by which the later keyframe was moved in the map frame, in metres, or
            in units of the map; None for a merge.
        correction_deg: angle by which it was turned; None for a merge.
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
