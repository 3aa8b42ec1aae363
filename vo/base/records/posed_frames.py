"""The frames of a run that have a pose, and how each got it."""

from __future__ import annotations

from vo.base.frozen import frozen
from vo.base.types import Bools, Ints, Trajectory


@frozen(eq=False)
class PosedFrames:
    """The frames of a run that have a pose, in time order.

    Attributes:
        frame_index: (N,) numbers of the frames in the source.
        segment: (N,) number of the segment of each.
        world: (N,) number of the first of the segments that share its world frame.
        is_keyframe: (N,).
        interpolated: (N,) frames that were not tracked but lie between two that were.
        inertial: (N,) 0, or -1 for a pose by the inertial sensor, -2 for its orientation; or None.
    """

    frame_index: Ints
    segment: Ints
    world: Ints
    is_keyframe: Bools
    interpolated: Bools
    trajectory: Trajectory
    inertial: Ints | None = None
