"""Poses, frames and covariances of a run as lines of CSV."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Estimate, KeyframePose

POSES_HEADING = "frame,stamp_ns,segment,keyframe,interpolated,tx,ty,tz,qx,qy,qz,qw"


def pose_lines(placed: PosedFrames, fields: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows under `POSES_HEADING`; `interpolated` is 2, 3 for poses by an inertial sensor.

    `fields`: numbers of each pose as in a TUM file
    (`vo.recordings.formats.trajectory.pose_fields`).
    """
    interpolated = placed.interpolated.astype(int)
    if placed.inertial is not None:
        interpolated = np.where(placed.inertial < 0, 1 - placed.inertial, interpolated)
    columns = (
        placed.frame_index.tolist(),
        placed.trajectory.stamps_ns.tolist(),
        placed.world.tolist(),
        placed.is_keyframe.astype(int).tolist(),
        interpolated.tolist(),
    )
    for frame, stamp, segment, keyframe, how, numbers in zip(*columns, fields, strict=True):
        yield f"{frame},{stamp},{segment},{keyframe},{how},{','.join(numbers)}"


_AXES = ("rx", "ry", "rz", "tx", "ty", "tz")
_ROWS, _COLUMNS = np.triu_indices(6)
_ENTRIES = ",%.9e" * len(_ROWS)

COVARIANCE_HEADING = ",".join(
    ("stamp_ns", "frame", "segment")
    + tuple(f"c_{_AXES[i]}_{_AXES[j]}" for i, j in zip(_ROWS, _COLUMNS, strict=True))
)


def covariance_line(keyframe: KeyframePose) -> str:
    """`stamp_ns,frame,segment` and the upper triangle row by row; empty fields if unknown."""
    place = f"{keyframe.stamp_ns},{keyframe.frame_index},{keyframe.segment}"
    if keyframe.covariance is None:
        return place + "," * len(_ROWS)
    return place + _ENTRIES % tuple(keyframe.covariance[_ROWS, _COLUMNS].tolist())


# In the order of processing; other wall time is in the total only.
STAGES = (
    "read",
    "features",
    "start",
    "match",
    "align",
    "map",
    "window",
    "smooth",
    "memory",
    "inertial",
    "write",
    "record",
)

FRAMES_HEADING = ",".join(
    (
        *("frame", "stamp_ns", "state", "segment", "keyframe", "features", "matches", "inliers"),
        "total_ms",
        *(f"{stage}_ms" for stage in STAGES),
    )
)

_FRAME = "%d,%d,%s" + ",%d" * 5 + ",%.3f" * (1 + len(STAGES))


def frame_line(estimate: Estimate, stage_ms: Mapping[str, float]) -> str:
    """One frame with its wall time by stage, 0 for a stage that was not run."""
    counts = (estimate.features, estimate.matches, estimate.inliers)
    place = (estimate.frame_index, estimate.stamp_ns, estimate.state.value, estimate.segment)
    spent = (sum(stage_ms.values()), *(stage_ms.get(stage, 0.0) for stage in STAGES))
    return _FRAME % (*place, int(estimate.is_keyframe), *counts, *spent)
