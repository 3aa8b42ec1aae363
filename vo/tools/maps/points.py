"""Points of a map: each landmark once, where the last keyframe that observes it has it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import OutputError
from vo.base.geometry.transforms import transform_points
from vo.base.types import Bytes, Floats
from vo.engine.maps.map_file import MapFile
from vo.engine.places.records import PATCH_PX
from vo.recordings.formats.ply import write_ply
from vo.tools.maps.contents import marker_corners


class MapPoints(NamedTuple):
    """Points of one keyframe; rows belong together."""

    xyz: Floats  # (n, 3) in the world of the keyframe
    grey: Bytes  # (n,) uint8 grey levels


def points_of(map_file: MapFile, world: int) -> Iterator[MapPoints]:
    """The points of a world, keyframe by keyframe, newest first.

    Raises:
        SourceError: a keyframe is damaged.
    """
    known: dict[int, np.ndarray[tuple[int, ...], np.dtype[np.int64]]] = {}
    placed = map_file.placed
    for row in np.flatnonzero(placed.world == world)[::-1].tolist():
        place = map_file.place(placed.keys[row])
        landmarks, session = place.landmarks, place.key.session
        seen = known.get(session, np.zeros(0, np.int64))
        new = ~np.isin(landmarks.id, seen)
        known[session] = np.union1d(seen, landmarks.id)
        xyz = placed.scale[row] * landmarks.xyz[new].astype(np.float64)
        centre = PATCH_PX // 2
        world_xyz = transform_points(placed.world_from_cam[row], xyz)
        yield MapPoints(world_xyz, landmarks.patch[new, centre, centre])


def export_ply(map_file: MapFile, path: Path, world: int) -> int:
    """Write the points of a world, and the corners of its markers in white, as a PLY file.

    Returns their number.

    Raises:
        SourceError: a keyframe is damaged.
        OutputError: the file cannot be written.
    """
    parts = list(points_of(map_file, world))
    corners = marker_corners(map_file.markers, map_file.placed, world)
    parts.append(MapPoints(corners, np.full(len(corners), 255, np.uint8)))
    count = sum(len(part.xyz) for part in parts)
    comment = f"world {world} of the map {map_file.path.name}"
    try:
        write_ply(path, count, ((p.xyz, p.grey) for p in parts), comment)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    return count
