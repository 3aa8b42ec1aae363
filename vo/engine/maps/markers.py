"""Markers in a map file, and where they are in its worlds."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np

from vo.engine.geometry import sim3
from vo.engine.maps.checks import MAX_NUMBER, check_poses, listed, text
from vo.engine.markers.dictionaries import known_dictionaries, marker_count
from vo.engine.places.records import MarkerVisit, PlaceKey, RegisteredKeyframes

MARKERS_VERSION = 1
_MIN_LENGTH_M, _MAX_LENGTH_M = 0.001, 5.0
_MAX_VARIANCE = 1e6
_ROUNDING = 1e-9  # of the largest element of a covariance
_ROW = np.dtype(
    [
        ("key", "<i8", 2),
        ("id", "<i8"),
        ("dictionary", "<i8"),
        ("length_m", "<f8"),
        ("cam_from_marker", "<f8", (4, 4)),
        ("scale", "<f8"),
        ("covariance", "<f8", (7, 7)),
        ("keyframes", "<i8"),
    ]
)


def encode_markers(markers: Sequence[MarkerVisit]) -> tuple[dict[str, Any], bytes]:
    """What the index of a map says about its markers, and their rows."""
    names = sorted({each.dictionary for each in markers})
    rows = [
        (
            each.key,
            each.id,
            names.index(each.dictionary),
            each.length_m,
            sim3.rigid_part(each.cam_from_marker),
            float(sim3.scale_of(each.cam_from_marker)),
            each.covariance,
            each.keyframes,
        )
        for each in markers
    ]
    return {"version": MARKERS_VERSION, "dictionaries": names}, np.array(rows, _ROW).tobytes()


def decode_markers(
    section: dict[str, Any], data: bytes, keys: Collection[PlaceKey]
) -> tuple[MarkerVisit, ...]:
    """The markers of a map.

    Args:
        section: what its index says about them.
        data: their rows.
        keys: keyframes of the map.

    Raises:
        ValueError: they cannot be markers of this map.
        KeyError, TypeError: something is missing, or of another type.
    """
    names = [text(name) for name in listed(section["dictionaries"])]
    if any(name not in known_dictionaries() for name in names):
        raise ValueError("a dictionary of markers is unknown")
    rows = np.frombuffer(data, _ROW)
    check_poses(rows["cam_from_marker"], rows["scale"])
    return tuple(_decoded(row, names, keys) for row in rows)


def _decoded(row: Any, names: Sequence[str], keys: Collection[PlaceKey]) -> MarkerVisit:
    key, which, number = PlaceKey(*row["key"].tolist()), int(row["dictionary"]), int(row["id"])
    if key not in keys:
        raise ValueError("a marker is relative to a keyframe that is not in the map")
    if not 0 <= which < len(names) or not 0 <= number < marker_count(names[which]):
        raise ValueError("the number of a marker is impossible")
    length_m, keyframes = float(row["length_m"]), int(row["keyframes"])
    if not _MIN_LENGTH_M <= length_m <= _MAX_LENGTH_M or not 1 <= keyframes <= MAX_NUMBER:
        raise ValueError("the side of a marker is impossible")
    covariance = row["covariance"].copy()
    if not (np.abs(covariance) < _MAX_VARIANCE).all():
        raise ValueError("the covariance of a marker is none")
    rounding = _ROUNDING * np.abs(covariance).max()
    is_symmetric = np.abs(covariance - covariance.T).max() <= rounding
    if not is_symmetric or np.linalg.eigvalsh(covariance).min() < -rounding:
        raise ValueError("the covariance of a marker is none")
    pose = sim3.similarity(row["cam_from_marker"], row["scale"])
    return MarkerVisit(key, number, names[which], length_m, pose, covariance, keyframes)


def at_keyframes(
    markers: Iterable[MarkerVisit], registered: RegisteredKeyframes, keys: Collection[PlaceKey]
) -> list[MarkerVisit]:
    """Markers relative to keyframes of a map, if need be to others than those of their visits.

    Args:
        markers: relative to keyframes that are placed; others are left out.
        registered: where keyframes are.
        keys: those of the map.
    """
    row_of = {key: row for row, key in enumerate(registered.keys)}
    world_from = sim3.similarity(registered.world_from_cam, registered.scale)
    found = []
    for each in markers:
        row = row_of.get(each.key)
        near = None if row is None else _nearest(row, registered, keys)
        if row is None or near is None:
            continue
        pose = each.cam_from_marker
        if near != row:  # the nearest one of the same path: what lies between them is odometry
            pose = sim3.inverse(world_from[near]) @ world_from[row] @ pose
        found.append(each._replace(key=registered.keys[near], cam_from_marker=pose))
    return found


def _nearest(row: int, registered: RegisteredKeyframes, keys: Collection[PlaceKey]) -> int | None:
    """Row of the nearest keyframe in time that is in a map, of the same session and world."""
    session, keyframe = registered.keys[row]
    if registered.keys[row] in keys:
        return row
    beside = [
        (abs(key.keyframe - keyframe), other)
        for other, key in enumerate(registered.keys)
        if key.session == session
        and key in keys
        and registered.world[other] == registered.world[row]
    ]
    return min(beside)[1] if beside else None
