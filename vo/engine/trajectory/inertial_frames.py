"""Frames that were not tracked, with poses by the inertial sensor between those that were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats, KeyframePose

INERTIAL, TURNED = -1.0, -2.0
"""`fraction` of such a frame in the table of frames; the latter has an orientation only."""


class InertialFrame(NamedTuple):
    """A frame with a pose by the inertial sensor.

    Attributes:
        keyframe: id of the keyframe with which it moves, that of the tracked frame beside it.
        world_from_cam0: (4, 4) in the world of the path.
        covariance: (6, 6), None if it is unknown.
        has_position: whether the position is known, too; else it is that of the keyframe.
    """

    keyframe: int
    frame_index: int
    stamp_ns: int
    segment: int
    world_from_cam0: Floats
    covariance: Floats | None
    has_position: bool = True


def inserted(
    frames: NDArray[Any], added: Sequence[InertialFrame], keyframe_from_cam: Floats
) -> NDArray[Any]:
    """Rows of all frames in time order, with m added ones, at (m, 4, 4) from their keyframes."""
    rows = np.zeros(len(added), frames.dtype)
    rows["frame_index"] = [frame.frame_index for frame in added]
    rows["stamp_ns"] = [frame.stamp_ns for frame in added]
    rows["segment"] = [frame.segment for frame in added]
    rows["keyframe"] = [frame.keyframe for frame in added]
    rows["fraction"] = [INERTIAL if frame.has_position else TURNED for frame in added]
    rows["keyframe_from_cam"] = keyframe_from_cam[:, :3]
    at = np.searchsorted(frames["frame_index"], rows["frame_index"])
    return np.insert(frames, at, rows)


def with_inertial(
    keyframes: Sequence[KeyframePose], added: Sequence[InertialFrame]
) -> list[KeyframePose]:
    """Keyframes, and frames by the inertial sensor, in time order: all with a covariance."""
    others = [
        KeyframePose(f.frame_index, f.stamp_ns, f.segment, f.world_from_cam0, f.covariance)
        for f in added
    ]
    numbers = {frame.frame_index for frame in added}
    kept = [keyframe for keyframe in keyframes if keyframe.frame_index not in numbers]
    return sorted([*kept, *others], key=lambda pose: pose.stamp_ns)


def with_reference(covariance: Floats, world_from_cam0: Floats, reference: KeyframePose) -> Floats:
    """Covariances (..., 6, 6) of motions since a keyframe, with that of the keyframe itself."""
    assert reference.covariance is not None
    moved = adjoint(inverse(world_from_cam0) @ reference.world_from_cam0)
    return np.asarray(covariance + moved @ reference.covariance @ np.swapaxes(moved, -1, -2))
