"""Frames that were not tracked, with poses by the inertial sensor between those that were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.types import Floats, KeyframePose

INERTIAL = -1.0
"""`fraction` of such a frame in the table of frames."""


class InertialFrame(NamedTuple):
    """A frame with a pose by the inertial sensor.

    Attributes:
        after: row of the tracked frame before it, with whose keyframe it moves.
        frame_index: number of the frame.
        stamp_ns: its time.
        segment: that of the tracked frame.
        world_from_cam0: (4, 4) in the world of the path.
        covariance: (6, 6), None if it is unknown.
    """

    after: int
    frame_index: int
    stamp_ns: int
    segment: int
    world_from_cam0: Floats
    covariance: Floats | None


def inserted(
    frames: NDArray[Any], added: Sequence[InertialFrame], keyframe_from_cam: Floats
) -> NDArray[Any]:
    """Rows of all frames in time order.

    Args:
        frames: (n,) rows of the frames so far.
        added: m frames, by increasing number.
        keyframe_from_cam: (m, 4, 4) of these, in the units of the odometry.
    """
    after = np.array([frame.after for frame in added], np.int64)
    rows = np.zeros(len(added), frames.dtype)
    rows["frame_index"] = [frame.frame_index for frame in added]
    rows["stamp_ns"] = [frame.stamp_ns for frame in added]
    rows["segment"] = [frame.segment for frame in added]
    rows["keyframe"] = frames["keyframe"][after]
    rows["fraction"] = INERTIAL
    rows["keyframe_from_cam"] = keyframe_from_cam[:, :3]
    return np.insert(frames, after + 1, rows)


def with_inertial(
    keyframes: Sequence[KeyframePose], added: Sequence[InertialFrame]
) -> list[KeyframePose]:
    """Keyframes, and frames by the inertial sensor, in time order: all with a covariance."""
    others = [
        KeyframePose(f.frame_index, f.stamp_ns, f.segment, f.world_from_cam0, f.covariance)
        for f in added
    ]
    return sorted([*keyframes, *others], key=lambda pose: pose.stamp_ns)
