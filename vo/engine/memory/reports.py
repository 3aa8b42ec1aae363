"""What is reported of loops and relocalisations."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.records.closed_loops import ClosedLoop, Relocalisation
from vo.base.types import Floats
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.records import Loop, PlaceKey


class LoopEnds(NamedTuple):
    """The frames of a loop.

    Attributes:
        later: of the run.
        earlier: of the run or of the loaded map.
        session: number of the session of the loaded map; None for the run itself.
    """

    later: FrameId
    earlier: FrameId
    session: int | None


def correction_of(before: Floats, after: Floats) -> tuple[float, float]:
    """Distance and angle in degrees from one pose (4, 4) to another."""
    change = inverse(before) @ after
    return float(np.linalg.norm(change[:3, 3])), math.degrees(rotation_angle(change[:3, :3]))


def closed_loop(
    loop: Loop,
    ends: LoopEnds,
    correction: tuple[float, float] | None,
    wrong: Collection[PlaceKey],
) -> ClosedLoop:
    """A loop that is accepted.

    Args:
        loop: the loop.
        ends: its frames.
        correction: of the later keyframe; None where the loop connects two worlds.
        wrong: keyframes whose motion since the one before the loops have shown to be wrong.
    """
    kind = "loop" if loop.marker is None else "marker"
    if correction is None:
        kind = "merge"
    elif any(loop.earlier < key <= loop.later for key in wrong):
        kind = "repair"
    return ClosedLoop(
        kind=kind if ends.session is None else "session",
        frame=ends.later.index,
        earlier_frame=ends.earlier.index,
        segment=ends.later.segment,
        earlier_segment=ends.earlier.segment,
        inliers=loop.inliers,
        corrected_from=None,
        correction_m=None if correction is None else correction[0],
        correction_deg=None if correction is None else correction[1],
        earlier_session=ends.session,
        marker=loop.marker,
    )


def relocalisation(
    ends: LoopEnds, inliers: int, loops: int, correction: tuple[float, float]
) -> Relocalisation:
    """A relocalisation by so many loops, of which the newest is given; without its frame."""
    return Relocalisation(
        frame=-1,
        segment=ends.later.segment,
        keyframe=ends.later.index,
        earlier_frame=ends.earlier.index,
        loops=loops,
        inliers=inliers,
        correction_m=correction[0],
        correction_deg=correction[1],
        earlier_session=ends.session,
    )
