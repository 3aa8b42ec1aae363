"""Smoothed poses as lines of CSV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vo.base.records.placed_frames import PlacedFrames

POSES_HEADING = "frame,stamp_ns,segment,keyframe,interpolated,tx,ty,tz,qx,qy,qz,qw"


def pose_lines(placed: PlacedFrames, fields: Sequence[Sequence[str]]) -> Iterator[str]:
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
    for *columns_of_row, numbers in zip(*columns, fields, strict=True):
        yield ",".join((*map(str, columns_of_row), *numbers))
