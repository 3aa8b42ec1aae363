"""Writer of point clouds as binary PLY files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from vo.base.files.complete_file import complete_file
from vo.base.types import Bytes, Floats

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


def write_ply(path: Path, count: int, parts: Iterable[tuple[Floats, Bytes]], comment: str) -> None:
    """Write points with their grey levels; the file appears when it is complete.

    `parts`: positions (M, 3) and grey levels (M,), `count` of them altogether.

    Raises:
        OSError: the file cannot be written.
    """
    header = _HEADER.format(comment=" ".join(comment.split()), count=count)
    with complete_file(path) as file:
        file.write(header.encode("ascii", "replace"))
        for xyz, grey in parts:
            rows = np.empty(len(xyz), dtype=_ROW)
            rows["xyz"], rows["rgb"] = xyz, grey[:, None]
            file.write(rows.tobytes())
