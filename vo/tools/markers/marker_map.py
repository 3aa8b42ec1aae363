"""Maps of markers with known poses: YAML, JSON, and the markers.csv of a run.

The frame of a marker has its origin in the middle, x to the right, y up and z out of it; the map
has a frame of its own, in metres.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vo.base.errors import ConfigError, SourceError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.files.bounded_yaml import load_yaml
from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.base.types import Floats
from vo.engine.markers.dictionaries import AUTO, dictionary_name, marker_count
from vo.engine.markers.marker_problem import square_points
from vo.tools.markers.boards import check_length

DEFAULT_SIGMA_M = 0.005
_MAX_SIGMA_M = 10.0
_MAX_COORDINATE_M = 1e6
_QUAT_TOLERANCE = 0.01
_SQUARE_TOLERANCE = 0.03  # of a side, for corners that somebody has measured
_POSITION, _QUAT = ("tx", "ty", "tz"), ("qx", "qy", "qz", "qw")
_KEYS = ("id", "length_m", "position", "quat_xyzw", "corners", "sigma_m")


class KnownMarker(NamedTuple):
    """A marker of a map."""

    id: int
    length_m: float
    map_from_marker: Floats  # (4, 4), in metres
    sigma_m: float  # standard deviation of its position along each axis


@dataclass(frozen=True, eq=False)
class MarkerMap:
    """Markers whose poses are known."""

    name: str
    dictionary: str  # as for `vo markers`, `auto` if the file does not name it
    markers: Mapping[int, KnownMarker]


def read_marker_map(path: Path) -> MarkerMap:
    """Read a map of markers (docs/markers.md has the format).

    Raises:
        SourceError: the file is missing or cannot be read, or what it says is no map.
    """
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SourceError(
            f"{path} cannot be read: {reason}; `marker_map` takes the side of the squares in "
            "metres, such as 0.16, or a file with a map of markers"
        ) from error
    try:
        if path.suffix.lower() == ".csv":
            name, markers = _from_table(text)
        else:
            is_json = path.suffix.lower() == ".json"
            name, markers = _from_document(load_json(text) if is_json else load_yaml(text))
        return MarkerMap(str(path), name, _by_id(name, markers))
    except (ValueError, ConfigError) as error:
        raise SourceError(f"{path} is no map of markers: {error}") from error


def _by_id(name: str, markers: Iterable[KnownMarker]) -> dict[int, KnownMarker]:
    found: dict[int, KnownMarker] = {}
    for marker in markers:
        if marker.id in found:
            raise ValueError(f"marker {marker.id} is in it twice; each marker needs its own id")
        if name != AUTO and marker.id >= marker_count(name):
            raise ValueError(
                f"marker {marker.id} is not in {name}, which has {marker_count(name)} markers"
            )
        found[marker.id] = marker
    if not found:
        raise ValueError("it has no markers")
    return found


def _from_document(document: Any) -> tuple[str, list[KnownMarker]]:
    """The dictionary and the markers of a YAML or JSON document."""
    if not isinstance(document, dict) or not isinstance(document.get("markers"), list):
        raise ValueError("it needs a list 'markers' (docs/markers.md has the format)")
    unknown = sorted(str(key) for key in document.keys() - {"dictionary", "length_m", "markers"})
    if unknown:
        raise ValueError(f"unknown key '{unknown[0]}'; use dictionary, length_m and markers")
    name = dictionary_name(str(document.get("dictionary", AUTO)))
    common = document.get("length_m")
    return name, [_marker(entry, common) for entry in document["markers"]]


def _marker(entry: Any, common_length: Any) -> KnownMarker:
    if not isinstance(entry, dict) or "id" not in entry:
        raise ValueError("each of its markers needs an id")
    number = _number(entry["id"])
    where = f"marker {number}"
    unknown = sorted(str(key) for key in entry.keys() - set(_KEYS))
    if unknown:
        raise ValueError(f"{where} has the unknown key '{unknown[0]}'; use {', '.join(_KEYS)}")
    sigma_m = _float(entry.get("sigma_m", DEFAULT_SIGMA_M), f"sigma_m of {where}")
    length = entry.get("length_m", common_length)
    if "corners" in entry:
        if "position" in entry or "quat_xyzw" in entry:
            raise ValueError(f"{where} has corners and a pose; give one of them")
        corners = _array(entry["corners"], (4, 3), f"corners of {where}")
        pose, length_m = _pose_of_corners(corners, where)
        if length is not None:
            given = _float(length, f"length_m of {where}")
            if abs(given - length_m) > _SQUARE_TOLERANCE * length_m:
                raise ValueError(
                    f"{where} has sides of {length_m:.4g} m by its corners, and a length_m of "
                    f"{given:g}"
                )
        return _checked(number, length_m, pose, sigma_m)
    if "position" not in entry or "quat_xyzw" not in entry:
        raise ValueError(f"{where} needs position and quat_xyzw, or corners")
    if length is None:
        raise ValueError(f"{where} has no length_m, and the map has none for all markers")
    position = _array(entry["position"], (3,), f"position of {where}")
    quat = _array(entry["quat_xyzw"], (4,), f"quat_xyzw of {where}")
    length_m = _float(length, f"length_m of {where}")
    return _checked(number, length_m, _pose(position, quat, where), sigma_m)


def _from_table(text: str) -> tuple[str, list[KnownMarker]]:
    """The dictionary and the markers of a markers.csv."""
    rows = list(csv.DictReader(text.splitlines()))
    needed = ("id", *_POSITION, *_QUAT, "length_m")
    missing = [name for name in needed if not rows or name not in rows[0]]
    if missing:
        raise ValueError(f"it has no column {missing[0]} with values; it needs {', '.join(needed)}")
    segments = sorted({row["segment"] for row in rows if row.get("segment")})
    if len(segments) > 1:
        raise ValueError(
            f"its markers are in the frames of the segments {', '.join(segments)}, and how these "
            "lie to each other is unknown: keep the rows of one"
        )
    names = sorted({dictionary_name(row["dictionary"]) for row in rows if row.get("dictionary")})
    if len(names) > 1:
        raise ValueError(f"it has markers of the dictionaries {', '.join(names)}; use one")
    markers = []
    for row in rows:
        number = _number(row["id"])
        where = f"marker {number}"
        sigma_m = _float(row.get("sigma_m") or DEFAULT_SIGMA_M, f"sigma_m of {where}")
        values = np.array([_float(row[key], f"{key} of {where}") for key in (*_POSITION, *_QUAT)])
        length_m = _float(row["length_m"], f"length_m of {where}")
        pose = _pose(values[:3], values[3:], where)
        markers.append(_checked(number, length_m, pose, sigma_m))
    return (names[0] if names else AUTO), markers


def _checked(number: int, length_m: float, pose: Floats, sigma_m: float) -> KnownMarker:
    check_length(length_m)
    if not np.abs(pose[:3, 3]).max() <= _MAX_COORDINATE_M:
        raise ValueError(f"marker {number} is more than {_MAX_COORDINATE_M:g} m from the origin")
    if not 0.0 <= sigma_m <= _MAX_SIGMA_M:
        raise ValueError(f"sigma_m of marker {number} is {sigma_m:g}; give metres, such as 0.005")
    return KnownMarker(number, length_m, pose, max(sigma_m, 1e-6))


def _pose(position: Floats, quat_xyzw: Floats, where: str) -> Floats:
    norm = float(np.linalg.norm(quat_xyzw))
    if not abs(norm - 1.0) <= _QUAT_TOLERANCE:
        raise ValueError(f"the quaternion of {where} has the length {norm:.4g}, not 1")
    return make_transform(rotation_from_quat_xyzw(quat_xyzw / norm), position)


def _pose_of_corners(corners: Floats, where: str) -> tuple[Floats, float]:
    """Pose and side of a square, whose corners begin at the top left and go clockwise."""
    right = 0.5 * (corners[1] - corners[0] + corners[2] - corners[3])
    up = 0.5 * (corners[0] - corners[3] + corners[1] - corners[2])
    length_m = 0.5 * float(np.linalg.norm(right) + np.linalg.norm(up))
    if not length_m > 0.0:
        raise ValueError(f"the corners of {where} are no square")
    u, _, vt = np.linalg.svd(np.column_stack([right, up]), full_matrices=False)
    sides = u @ vt  # the orthonormal pair that is closest
    rotation = np.column_stack([sides, np.cross(sides[:, 0], sides[:, 1])])
    pose = make_transform(rotation, corners.mean(axis=0))
    expected = square_points(length_m) @ rotation.T + pose[:3, 3]
    if np.abs(expected - corners).max() > _SQUARE_TOLERANCE * length_m:
        raise ValueError(
            f"the corners of {where} are no square; give them from the top left, clockwise"
        )
    return pose, length_m


def _number(value: Any) -> int:
    text = str(value).strip()
    if isinstance(value, bool) or not (text.isascii() and text.isdigit() and len(text) < 7):
        raise ValueError(f"a marker has the id '{value}'; ids are 0, 1, 2, ...")
    return int(text)


def _float(value: Any, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{what} is '{value}', not a number") from error
    if isinstance(value, bool) or not np.isfinite(number):
        raise ValueError(f"{what} is '{value}', not a number")
    return number


def _array(value: Any, shape: tuple[int, ...], what: str) -> Floats:
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{what} must be {' x '.join(map(str, shape))} numbers") from error
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"{what} must be {' x '.join(map(str, shape))} numbers")
    return found
