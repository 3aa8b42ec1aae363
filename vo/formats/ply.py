"""Writer of point clouds as binary PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vo.types import Bytes, Floats

_ROW = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
_HEADER = """ply
format binary_little_endian 1.0
comment {comment}
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


def write_ply(path: Path, xyz: Floats, grey: Bytes, comment: str) -> None:
    """Write points (M, 3) with their grey levels (M,).

    Args:
        path: the file; an existing one is replaced.
        xyz: (M, 3) positions.
        grey: (M,) grey levels.
        comment: comment in the header, one line.

    Raises:
        OSError: the file cannot be written.
    """
    rows = np.empty(len(xyz), dtype=_ROW)
    rows["xyz"], rows["rgb"] = xyz, grey[:, None]
    header = _HEADER.format(comment=" ".join(comment.split()), count=len(rows))
    path.write_bytes(header.encode("ascii", "replace") + rows.tobytes())
