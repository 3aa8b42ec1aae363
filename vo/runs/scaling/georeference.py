"""The path on the globe: GeoJSON and KML, in WGS 84."""

from __future__ import annotations

import json
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from vo.base.errors import OutputError
from vo.base.geometry.geodesy import geodetic_from_enu
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Floats
from vo.runs.scaling.position_source import PositionSource

GEOJSON, KML = "path.geojson", "path.kml"
_DEGREE_DIGITS = 9  # a tenth of a millimetre
_HEIGHT_DIGITS = 3


def write_georeference(folder: Path, path: PosedFrames, source: PositionSource) -> list[str]:
    """Write `path.geojson` and `path.kml`, one line for each world that could be placed.

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
    for alignment in source.alignments:
        rows = path.world == alignment.segment
        enu = alignment.transform(path.trajectory.positions[rows])
        assert alignment.positions.origin is not None
        lines.append((alignment.segment, geodetic_from_enu(enu, alignment.positions.origin)))
    _write(folder / GEOJSON, _geojson(path, lines))
    _write(folder / KML, _kml(lines))
    missing = sorted(set(path.world.tolist()) - {segment for segment, _ in lines})
    if not missing:
        return []
    numbers = ", ".join(map(str, missing))
    return [f"not placed on the globe, and left out of {GEOJSON} and {KML}: segments {numbers}"]


def _geojson(path: PosedFrames, lines: list[tuple[int, Floats]]) -> str:
    """One feature a world (RFC 7946: longitude, latitude, height), with stamps of its points."""
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
    return json.dumps({"type": "FeatureCollection", "features": features}) + "\n"


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
