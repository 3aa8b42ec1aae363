"""The path on the globe, in GeoJSON, KML and east, north and up; and the positions beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from vo.base.errors import OutputError
from vo.base.geometry.geodesy import geodetic_from_enu
from vo.base.geometry.transforms import make_transform
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Floats, Trajectory
from vo.outputs.results.folder import GLOBE, POSITIONS
from vo.recordings.formats.trajectory import write_tum
from vo.runs.scaling.position_source import PositionSource

GEOJSON, KML, ENU = GLOBE
_MARGIN_NS = 1_000_000_000  # of positions before and after a path
_METRE_DIGITS = 4
_DEGREE_DIGITS = 9  # a tenth of a millimetre
_HEIGHT_DIGITS = 3


def write_georeference(folder: Path, path: PosedFrames, source: PositionSource) -> list[str]:
    """Write `path.geojson`, `path.kml` and `path_enu.tum` of the worlds that could be placed.

    Args:
        folder: of the results.
        path: the final path in metres.
        source: after `measure`; its positions have an origin.

    Returns:
        Notes for the user: what could not be placed.

    Raises:
        OutputError: a file cannot be written.
    """
    lines: list[tuple[int, Floats]] = []
    origin = source.positions.origin
    poses, is_placed = path.trajectory.world_from_cam.copy(), np.zeros(len(path.world), bool)
    for alignment in source.alignments:
        rows = path.world == alignment.segment
        origin = alignment.positions.origin  # another where columns were exchanged
        assert origin is not None
        poses[rows] = make_transform(alignment.rotation, alignment.translation) @ poses[rows]
        is_placed |= rows
        lines.append((alignment.segment, geodetic_from_enu(poses[rows, :3, 3], origin)))
    _write(folder / GEOJSON, _geojson(path, lines, origin))
    _write(folder / KML, _kml(lines))
    write_tum(folder / ENU, Trajectory(path.trajectory.stamps_ns[is_placed], poses[is_placed]))
    missing = sorted(set(path.world.tolist()) - {segment for segment, _ in lines})
    if not missing:
        return []
    numbers = ", ".join(map(str, missing))
    return [f"not placed on the globe, and left out of {GEOJSON} and {KML}: segments {numbers}"]


def write_positions(folder: Path, path: PosedFrames, source: PositionSource) -> None:
    """Write the positions during each world of the path, in this world and on the globe.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = ["stamp_ns,segment,tx,ty,tz,latitude,longitude,height"]
    for alignment in source.alignments:
        given, times = (
            alignment.positions,
            path.trajectory.stamps_ns[path.world == alignment.segment],
        )
        inside = (given.stamps_ns >= times[0] - _MARGIN_NS) & (
            given.stamps_ns <= times[-1] + _MARGIN_NS
        )
        xyz = given.xyz[inside]
        in_world = np.round((xyz - alignment.translation) @ alignment.rotation, _METRE_DIGITS)
        globe = [",,"] * len(xyz)
        if given.origin is not None:
            places = geodetic_from_enu(xyz, given.origin)
            globe = [f"{a:.{_DEGREE_DIGITS}f},{b:.{_DEGREE_DIGITS}f},{h:.3f}" for a, b, h in places]
        for stamp, place, known in zip(given.stamps_ns[inside], in_world, globe, strict=True):
            numbers = ",".join(map(str, place.tolist()))
            lines.append(f"{stamp},{alignment.segment},{numbers},{known}")
    _write(folder / POSITIONS, "\n".join(lines) + "\n")


def _geojson(path: PosedFrames, lines: list[tuple[int, Floats]], origin: Floats | None) -> str:
    """One feature a world (RFC 7946: longitude, latitude, height), with stamps of its points.

    `origin`: of the frame of `path_enu.tum`, a foreign member.
    """
    features = [
        {
            "type": "Feature",
            "properties": {
                "segment": segment,
                "stamps_ns": path.trajectory.stamps_ns[path.world == segment].tolist(),
            },
            "geometry": {"type": "LineString", "coordinates": _coordinates(geodetic)},
        }
        for segment, geodetic in lines
        if len(geodetic) > 1
    ]
    content: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if origin is not None:
        content["enu_origin"] = _coordinates(origin[None])[0]
    return json.dumps(content) + "\n"


def _kml(lines: list[tuple[int, Floats]]) -> str:
    placemarks = "".join(
        f"<Placemark><name>{escape(f'segment {segment}')}</name><LineString>"
        "<altitudeMode>absolute</altitudeMode><coordinates>"
        + " ".join(",".join(map(str, point)) for point in _coordinates(geodetic))
        + "</coordinates></LineString></Placemark>\n"
        for segment, geodetic in lines
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n{placemarks}</Document></kml>\n'
    )


def _coordinates(geodetic: Floats) -> list[list[float]]:
    """Longitude, latitude and height of each point."""
    degrees = np.round(geodetic[:, [1, 0]], _DEGREE_DIGITS)
    height = np.round(geodetic[:, 2:], _HEIGHT_DIGITS)
    return [list(map(float, row)) for row in np.column_stack([degrees, height])]


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
