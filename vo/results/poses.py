"""Poses frame by frame as lines of CSV."""

from __future__ import annotations

from collections.abc import Iterator

from vo.formats.trajectory import pose_fields
from vo.types import PlacedFrames

POSES_HEADING = "frame,stamp_ns,segment,keyframe,interpolated,tx,ty,tz,qx,qy,qz,qw"


def pose_lines(placed: PlacedFrames) -> Iterator[str]:
    """Rows under `POSES_HEADING`; flags are 0 or 1, poses have the digits of a TUM line."""
    columns = (
        placed.frame_index.tolist(),
        placed.trajectory.stamps_ns.tolist(),
        placed.segment.tolist(),
        placed.is_keyframe.astype(int).tolist(),
        placed.interpolated.astype(int).tolist(),
    )
    for *marks, pose in zip(*columns, placed.trajectory.world_from_cam, strict=True):
        yield ",".join((*map(str, marks), *pose_fields(pose)))
