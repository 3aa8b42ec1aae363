"""Covariances of keyframe poses as lines of CSV."""

from __future__ import annotations

import numpy as np

from vo.base.types import KeyframePose

_AXES = ("rx", "ry", "rz", "tx", "ty", "tz")
_ROWS, _COLUMNS = np.triu_indices(6)

COVARIANCE_HEADING = ",".join(
    ("stamp_ns", "frame", "segment")
    + tuple(f"c_{_AXES[i]}_{_AXES[j]}" for i, j in zip(_ROWS, _COLUMNS, strict=True))
)


def covariance_line(keyframe: KeyframePose) -> str:
    """`stamp_ns,frame,segment` and the upper triangle row by row; empty fields if unknown."""
    place = f"{keyframe.stamp_ns},{keyframe.frame_index},{keyframe.segment}"
    if keyframe.covariance is None:
        return place + "," * len(_ROWS)
    entries = keyframe.covariance[_ROWS, _COLUMNS].tolist()
    return ",".join([place, *[f"{value:.9e}" for value in entries]])
