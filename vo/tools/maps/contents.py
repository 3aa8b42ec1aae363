"""What a map contains, and its points: each landmark as the last keyframe that has it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vo.base.errors import ConfigError, OutputError
from vo.base.geometry.transforms import quat_xyzw_from_rotation, transform_points
from vo.base.types import Bytes, Floats
from vo.engine.geometry import sim3
from vo.engine.maps.map_file import MapFile
from vo.engine.markers.dictionaries import smallest_containing
from vo.engine.markers.marker_problem import square_points
from vo.engine.places.records import PATCH_PX, MarkerVisit, RegisteredKeyframes
from vo.recordings.formats.ply import write_ply


def map_contents(map_file: MapFile) -> dict[str, Any]:
    """Plain values for JSON; every keyframe is read, and so its checksum verified.

    Raises:
        SourceError: a keyframe is damaged.
    """
    header = map_file.header
    observations, metric = 0, set(header.metric_worlds)
    for key, world in zip(map_file.keys, map_file.placed.world.tolist(), strict=True):
        place = map_file.place(key)
        observations += len(place.landmarks.id)
        if place.is_metric:
            metric.add(world)
    worlds, counts = np.unique(map_file.placed.world, return_counts=True)
    pairs = zip(worlds.tolist(), counts.tolist(), strict=True)
    return {
        "path": str(map_file.path),
        "bytes": map_file.path.stat().st_size,
        "sessions": list(header.sessions),
        "keyframes": len(map_file),
        "worlds": [
            {
                "world": world,
                "keyframes": count,
                "length_unit": "m" if world in metric else "map units",
            }
            for world, count in pairs
        ],
        "metric_worlds": list(header.metric_worlds),
        "loops": len(map_file.loops),
        "observations": observations,
        "camera": f"{header.camera.width}x{header.camera.height}",
        "vocabulary": header.vocabulary,
        "markers": listed_markers(map_file.markers, map_file.placed),
    }


def chosen_world(map_file: MapFile, world: int | None) -> int:
    """The number of a world of a map; without one, that with most keyframes.

    Raises:
        ConfigError: the map has no such world.
    """
    numbers, counts = np.unique(map_file.placed.world, return_counts=True)
    known = numbers.tolist()
    if not known or (world is not None and world not in known):
        text = ", ".join(map(str, known)) or "none"
        raise ConfigError(f"{map_file.path} has no such world; its worlds are: {text}")
    return int(numbers[np.argmax(counts)]) if world is None else world


def listed_markers(
    markers: Sequence[MarkerVisit], registered: RegisteredKeyframes
) -> list[dict[str, Any]]:
    """Where each marker is in each world, by the visit that is the most certain one.

    Positions and `sigma_m` are in the unit of the world, and in metres by the sides of markers.
    """
    in_world = _best_visits(markers, registered)
    names = {
        name: smallest_containing(name, [each.id for each in markers if each.dictionary == name])
        for name in sorted({each.dictionary for each in markers})
    }
    return [
        {
            "id": each.marker.id,
            "dictionary": names[each.marker.dictionary],
            "length_m": each.marker.length_m,
            "world": each.world,
            "position": each.world_from_marker[:3, 3].tolist(),
            "quat_xyzw": quat_xyzw_from_rotation(
                sim3.rigid_part(each.world_from_marker)[:3, :3]
            ).tolist(),
            "sigma_m": _sigma_m(each.marker),
            "visits": each.visits,
        }
        for each in in_world
    ]


def marker_corners(
    markers: Sequence[MarkerVisit], registered: RegisteredKeyframes, world: int
) -> Floats:
    """(n, 3) corners of the markers of a world."""
    corners = [
        transform_points(each.world_from_marker, square_points(each.marker.length_m))
        for each in _best_visits(markers, registered)
        if each.world == world
    ]
    return np.concatenate([np.zeros((0, 3)), *corners])


class _InWorld(NamedTuple):
    """A marker in a world, by the visit that is the most certain one."""

    world: int  # number of the world
    marker: MarkerVisit  # relative to its keyframe
    world_from_marker: Floats  # (4, 4) similarity from metres to the unit of the world
    visits: int  # number of visits


def _best_visits(markers: Sequence[MarkerVisit], registered: RegisteredKeyframes) -> list[_InWorld]:
    """Each marker in each world, by worlds, dictionaries and ids."""
    row_of = {key: row for row, key in enumerate(registered.keys)}
    world_from = sim3.similarity(registered.world_from_cam, registered.scale)
    visits: dict[tuple[int, str, int], list[MarkerVisit]] = {}
    for each in markers:
        world = int(registered.world[row_of[each.key]])
        visits.setdefault((world, each.dictionary, each.id), []).append(each)
    found = []
    for (world, _, _), group in sorted(visits.items()):
        best = min(group, key=_sigma_m)
        pose = world_from[row_of[best.key]] @ best.cam_from_marker
        found.append(_InWorld(world, best, pose, len(group)))
    return found


def _sigma_m(visit: MarkerVisit) -> float:
    """Standard deviation of the position relative to the keyframe, all axes together."""
    return float(np.sqrt(max(np.trace(visit.covariance[3:6, 3:6]), 0.0)))


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
    registered = map_file.placed
    for row in np.flatnonzero(registered.world == world)[::-1].tolist():
        place = map_file.place(registered.keys[row])
        landmarks, session = place.landmarks, place.key.session
        seen = known.get(session, np.zeros(0, np.int64))
        new = ~np.isin(landmarks.id, seen)
        known[session] = np.union1d(seen, landmarks.id)
        xyz = registered.scale[row] * landmarks.xyz[new].astype(np.float64)
        centre = PATCH_PX // 2
        world_xyz = transform_points(registered.world_from_cam[row], xyz)
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
