"""Smoothed poses as lines of CSV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vo.types import PlacedFrames

POSES_HEADING = "frame,stamp_ns,segment,keyframe,interpolated,tx,ty,tz,qx,qy,qz,qw"


def pose_lines(placed: PlacedFrames, fields: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows under `POSES_HEADING`; flags are 0 or 1, 2 for a pose by the inertial sensor alone.

    Args:
        placed: the frames.
        fields: numbers of each pose as in a TUM file (`vo.formats.trajectory.pose_fields`).
    """
    interpolated = placed.interpolated.astype(int)
    if placed.inertial is not None:
        interpolated[placed.inertial] = 2
    columns = (
        placed.frame_index.tolist(),
        placed.trajectory.stamps_ns.tolist(),
        placed.world.tolist(),
        placed.is_keyframe.astype(int).tolist(),
        interpolated.tolist(),
    )
    for *columns_of_row, numbers in zip(*columns, fields, strict=True):
        yield ",".join((*map(str, columns_of_row), *numbers))
