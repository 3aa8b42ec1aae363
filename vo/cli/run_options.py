"""Options of `vo run`, in blocks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vo.cli.options import (
    INPUT,
    ODOMETRY,
    OUTPUT,
    Config,
    Overrides,
)

if TYPE_CHECKING:
    from vo.runs.scaling.creation import ScaleOptions

# Headings of the options in `--help`, besides those in `options`.
_SCALE, _VISUALISATION = "Metric scale of one camera", "Visualisation with rerun"


class ImageSize(StrEnum):
    """Choices of `--rrd-images`."""

    FULL = "full"
    HALF = "half"
    NONE = "none"


@dataclass(frozen=True, kw_only=True)
class Live:
    """Live sources, and logs that are still being written."""

    follow: Annotated[
        bool,
        typer.Option(
            "--follow",
            help="Follow an MCAP file that is still being written, until it is closed or has not "
            "grown for 10 s.",
            rich_help_panel=INPUT,
        ),
    ] = False
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            metavar="SECONDS",
            help="Live: end after this time without images.",
            show_default="10",
            rich_help_panel=INPUT,
        ),
    ] = None
    duration: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            metavar="SECONDS",
            help="Live: end after this time.",
            show_default="until Ctrl-C",
            rich_help_panel=INPUT,
        ),
    ] = None
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Live: also write the tracked images to an MCAP file, for another run on them.",
            rich_help_panel=OUTPUT,
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the odometry."""

    config: Config = "default"
    overrides: Overrides = None
    threads: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Number of CPU cores to use, 0 for all; the result does not depend on it.",
            show_default="that of --config",
            rich_help_panel=ODOMETRY,
        ),
    ] = None
    no_imu: Annotated[
        bool,
        typer.Option(
            "--no-imu",
            help="Do not use the inertial sensor of the recording.",
            rich_help_panel=ODOMETRY,
        ),
    ] = False
    loops: Annotated[
        bool | None,
        typer.Option(
            "--loops/--no-loops",
            help="Recognise places that were seen before, and correct the drift.",
            show_default="that of --config: on, except for live sources and features other than "
            "orb",
            rich_help_panel=ODOMETRY,
        ),
    ] = None
    vocabulary: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Vocabulary of place recognition, from `vo vocabulary train`.",
            show_default="the built-in one",
            rich_help_panel=ODOMETRY,
        ),
    ] = None
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="Continue in a map from --save-map, whose places are recognised.",
            rich_help_panel=ODOMETRY,
        ),
    ] = None
    localize: Annotated[
        bool,
        typer.Option(
            "--localize",
            help="Only localise in --map, and add nothing to it.",
            rich_help_panel=ODOMETRY,
        ),
    ] = False

    @property
    def all(self) -> list[str]:
        """Overrides of settings, including those that have options of their own."""
        loops = True if self.loops is None and self.map_file is not None else self.loops
        given: dict[str, Any] = {
            "threads": self.threads,
            "memory.vocabulary": None if self.vocabulary is None else str(self.vocabulary),
            "memory.map": None if self.map_file is None else str(self.map_file),
            "memory.loops": loops,
            "memory.localize": self.localize or None,
            "inertial.enabled": False if self.no_imu else None,
        }
        texts = [f"{key}={json.dumps(value)}" for key, value in given.items() if value is not None]
        return [*(self.overrides or ()), *texts]


@dataclass(frozen=True, kw_only=True)
class Scale:
    """What measures the scale of a mono run."""

    scale_from: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|AUTO",
            help="Mono: the scale, from positions of another sensor: NMEA, CSV, a trajectory, a "
            "log (or LOG:/TOPIC) with GPS or wheel odometry, oxts of KITTI; auto: those in the "
            "recording.",
            rich_help_panel=_SCALE,
        ),
    ] = None
    scale_offset: Annotated[
        float,
        typer.Option(
            min=-9e9,
            max=9e9,
            metavar="SECONDS",
            help="Added to the times of --scale-from.",
            rich_help_panel=_SCALE,
        ),
    ] = 0.0
    lever_arm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            "--lever-arm",
            metavar="X Y Z",
            help="Where the sensor of --scale-from is, from the left camera: metres to the right, "
            "down and forward.",
            show_default="at the camera",
            rich_help_panel=_SCALE,
        ),
    ] = None
    georeference: Annotated[
        bool,
        typer.Option(
            "--georeference",
            help="Also write the path as path.geojson and path.kml in WGS 84, by the positions of "
            "--scale-from.",
            rich_help_panel=_SCALE,
        ),
    ] = False
    height: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Mono: the scale, from the height of an upright camera above flat ground.",
            rich_help_panel=_SCALE,
        ),
    ] = None
    markers: Annotated[
        str | None,
        typer.Option(
            metavar="METRES|FILE",
            help="Search ArUco or AprilTag markers with black squares of this side: they give a "
            "mono path its scale, and are written to markers.csv; or of a map with their poses, "
            "whose frame becomes that of the path (docs/markers.md).",
            rich_help_panel=_SCALE,
        ),
    ] = None
    marker_dictionary: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Dictionary of --markers, such as tag36h11; auto: the one that the images show.",
            rich_help_panel=_SCALE,
        ),
    ] = "auto"
    world: Annotated[
        str | None,
        typer.Option(
            metavar="MARKER:ID",
            help="Write the path in the frame of this marker, such as marker:7, instead of that of "
            "the first camera.",
            rich_help_panel=_SCALE,
        ),
    ] = None

    @property
    def sources(self) -> ScaleOptions:
        """The same for a run; `--markers` gives the side of all markers, or the file of a map."""
        from vo.runs.scaling.creation import ScaleOptions

        length_m, marker_map = None, None
        if self.markers is not None:
            try:
                length_m = float(self.markers)
            except ValueError:
                marker_map = Path(self.markers)
        return ScaleOptions(
            positions=self.scale_from,
            offset_ns=round(1e9 * self.scale_offset),
            georeference=self.georeference,
            height_m=self.height,
            marker_length_m=length_m,
            marker_dictionary=self.marker_dictionary,
            world=self.world,
            marker_map=marker_map,
            lever_arm_m=self.lever_arm,
        )


@dataclass(frozen=True, kw_only=True)
class Viewer:
    """Recording and streaming for the rerun viewer."""

    rrd: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Record for the rerun viewer to this file, for `vo view`.",
            rich_help_panel=_VISUALISATION,
        ),
    ] = None
    rrd_images: Annotated[
        ImageSize,
        typer.Option(help="Size of the images in the viewer.", rich_help_panel=_VISUALISATION),
    ] = ImageSize.HALF
    spawn: Annotated[
        bool,
        typer.Option(
            "--spawn", help="Open a rerun viewer and stream to it.", rich_help_panel=_VISUALISATION
        ),
    ] = False
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Stream to a running rerun viewer.",
            rich_help_panel=_VISUALISATION,
        ),
    ] = None
    serve: Annotated[
        bool,
        typer.Option(
            "--serve",
            help="Stream to a web page for a browser on this machine.",
            rich_help_panel=_VISUALISATION,
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Files and text to write beside the results."""

    save_map: Annotated[
        Path | None,
        typer.Option(
            "--save-map",
            metavar="FILE",
            help="Also write the stored keyframes and their poses, for --map and vo map.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also write an MCAP file for Foxglove.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    colmap: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Also write keyframes, their images and points as a COLMAP model.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    ply: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also write the points of the map as a PLY file.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    poses: Annotated[
        list[str] | None,
        typer.Option(
            metavar="-|ADDRESS",
            help="Send each pose at once: - (JSON lines on standard output), udp://HOST:PORT, or "
            "ws://HOST:PORT (a server for Foxglove; ws://:8765 for this machine alone); "
            "repeatable.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    profile: Annotated[
        bool,
        typer.Option(
            "--profile",
            help="Print the time spent in each stage, and save it in summary.json.",
            rich_help_panel=OUTPUT,
        ),
    ] = False
    fail_under: Annotated[
        str | None,
        typer.Option(
            metavar="PERCENT",
            help="Exit with status 4 if fewer frames have a pose, such as 90%, or if the path is "
            "not to be trusted.",
            rich_help_panel=OUTPUT,
        ),
    ] = None

    @property
    def poses_on_standard_output(self) -> bool:
        """Whether nothing else may be written there."""
        return "-" in (self.poses or ())
