"""Options of `vo run` that give a mono run its metric scale."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_SCALE = "Metric scale of one camera"

ScaleFrom = Annotated[
    str | None,
    typer.Option(
        metavar="FILE|AUTO",
        help="Mono: the scale, from positions of another sensor: NMEA, CSV, a trajectory, a log "
        "(or LOG:/TOPIC) with GPS or wheel odometry, oxts of KITTI; auto: those in the recording.",
        rich_help_panel=_SCALE,
    ),
]
ScaleOffset = Annotated[
    float,
    typer.Option(
        min=-9e9,
        max=9e9,
        metavar="SECONDS",
        help="Added to the times of --scale-from.",
        rich_help_panel=_SCALE,
    ),
]
LeverArm = Annotated[
    tuple[float, float, float] | None,
    typer.Option(
        "--lever-arm",
        metavar="X Y Z",
        help="Where the sensor of --scale-from is, from the left camera: metres to the right, "
        "down and forward.",
        show_default="at the camera",
        rich_help_panel=_SCALE,
    ),
]
Georeference = Annotated[
    bool,
    typer.Option(
        "--georeference",
        help="Also write the path as path.geojson and path.kml in WGS 84, by the positions of "
        "--scale-from.",
        rich_help_panel=_SCALE,
    ),
]
Height = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Mono: the scale, from the height of an upright camera above flat ground.",
        rich_help_panel=_SCALE,
    ),
]
Markers = Annotated[
    str | None,
    typer.Option(
        metavar="METRES|FILE",
        help="Search ArUco or AprilTag markers with black squares of this side: they give a mono "
        "path its scale, and are written to markers.csv; or of a map with their poses, whose frame "
        "becomes that of the path (docs/markers.md).",
        rich_help_panel=_SCALE,
    ),
]
MarkerDictionary = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Dictionary of --markers, such as tag36h11; auto: the one that the images show.",
        rich_help_panel=_SCALE,
    ),
]
World = Annotated[
    str | None,
    typer.Option(
        metavar="MARKER:ID",
        help="Write the path in the frame of this marker, such as marker:7, instead of that of the "
        "first camera.",
        rich_help_panel=_SCALE,
    ),
]


def length_or_map(markers: str | None) -> tuple[float | None, Path | None]:
    """What `--markers` was given: the side of all markers, or the file of their map."""
    if markers is None:
        return None, None
    try:
        return float(markers), None
    except ValueError:
        return None, Path(markers)
