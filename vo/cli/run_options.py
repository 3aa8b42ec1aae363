"""Options of `vo run`, in blocks."""

from __future__ import annotations

import json
from dataclasses import fields
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vo.cli.blocks import block, option
from vo.cli.options import (
    INPUT,
    ODOMETRY,
    OUTPUT,
    Config,
    Overrides,
)

if TYPE_CHECKING:
    from vo.outputs.recorders.exports import Exports
    from vo.runs.scaling.scale_sources import ScaleOptions

# Headings of the options in `--help`, besides those in `options`.
_SCALE, _VISUALISATION = "Metric scale of one camera", "Visualisation with rerun"


class ImageSize(StrEnum):
    """Choices of `--rrd-images`."""

    FULL = "full"
    HALF = "half"
    NONE = "none"


@block(INPUT)
class Live:
    """Live sources, and logs that are still being written."""

    follow: bool = option(
        "Follow an MCAP file that is still being written, until it is closed or has not "
        "grown for 10 s.",
        "--follow",
        default=False,
    )
    timeout: float | None = option(
        "Live: end after this time without images.",
        default=None,
        min=0.1,
        metavar="SECONDS",
        show_default="10",
    )
    allow_host: list[str] | None = option(
        "A host to which redirects and playlists of a live http:// stream may lead besides its "
        "own; repeatable.",
        default=None,
        metavar="HOST",
    )
    duration: float | None = option(
        "Live: end after this time.",
        default=None,
        min=0.1,
        metavar="SECONDS",
        show_default="until Ctrl-C",
    )
    record: Path | None = option(
        "Live: also write the tracked images to an MCAP file, for another run on them.",
        default=None,
        metavar="FILE",
        panel=OUTPUT,
    )


@block(ODOMETRY)
class Settings:
    """Settings of the odometry."""

    config: Config = "default"
    overrides: Overrides = None
    threads: int | None = option(
        "Number of CPU cores to use, 0 for all; the result does not depend on it.",
        default=None,
        min=0,
        metavar="N",
        show_default="that of --config",
    )
    no_imu: bool = option(
        "Do not use the inertial sensor of the recording.", "--no-imu", default=False
    )
    loops: bool | None = option(
        "Recognise places that were seen before, and correct the drift.",
        "--loops/--no-loops",
        default=None,
        show_default="that of --config: on, except for live sources and features other than orb",
    )
    vocabulary: Path | None = option(
        "Vocabulary of place recognition, from `vo vocabulary train`.",
        default=None,
        metavar="FILE",
        show_default="the built-in one",
    )
    map_file: Path | None = option(
        "Continue in a map from --save-map, whose places are recognised.",
        "--map",
        default=None,
        metavar="FILE",
    )
    localize: bool = option(
        "Only localise in --map, and add nothing to it.", "--localize", default=False
    )

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


@block(_SCALE)
class Scale:
    """What measures the scale of a mono run."""

    gps: str | None = option(
        "Positions of another sensor: they move the path where they show that it drifts, "
        "and give that of one camera its scale. NMEA, GPX, CSV, a trajectory, a log (or "
        "LOG:/TOPIC), oxts of KITTI; auto: those in the recording.",
        default=None,
        metavar="FILE|AUTO",
    )
    wheel: str | None = option(
        "Wheel odometry: the scale of one camera, also along the path and with --gps. A log (or "
        "LOG:/TOPIC), a CSV with speed and yaw_rate, poses of the base; auto: that in the "
        "recording.",
        default=None,
        metavar="FILE|AUTO",
    )
    scale_from: str | None = option(
        "Mono: only the scale, from positions as for --gps.",
        default=None,
        metavar="FILE|AUTO",
    )
    scale_offset: float = option(
        "Added to the times of --gps or --scale-from.",
        default=0.0,
        min=-9e9,
        max=9e9,
        metavar="SECONDS",
    )
    lever_arm: tuple[float, float, float] | None = option(
        "Where the sensor of --gps or --scale-from is, from the left camera: metres to the right, "
        "down and forward.",
        default=None,
        metavar="X Y Z",
        show_default="at the camera",
    )
    georeference: bool = option(
        "Also write the path as path.geojson and path.kml in WGS 84, by the positions of "
        "--gps or --scale-from.",
        "--georeference",
        default=False,
    )
    height: float | None = option(
        "Mono: the scale, from the height of an upright camera above flat ground.",
        default=None,
        metavar="METRES",
    )
    markers: str | None = option(
        "Search ArUco or AprilTag markers with black squares of this side: they give a "
        "mono path its scale, and are written to markers.csv; or of a map with their poses, "
        "whose frame becomes that of the path (docs/markers.md).",
        default=None,
        metavar="METRES|FILE",
    )
    marker_dictionary: str = option(
        "Dictionary of --markers, such as tag36h11; auto: the one that the images show.",
        default="auto",
        metavar="NAME",
    )
    world: str | None = option(
        "Write the path in the frame of this marker, such as marker:7, instead of that of "
        "the first camera.",
        default=None,
        metavar="MARKER:ID",
    )

    @property
    def sources(self) -> ScaleOptions:
        """The same for a run; `--markers` gives the side of all markers, or the file of a map."""
        from vo.runs.scaling.scale_sources import ScaleOptions

        length_m, marker_map = None, None
        if self.markers is not None:
            try:
                length_m = float(self.markers)
            except ValueError:
                marker_map = Path(self.markers)
        return ScaleOptions(
            positions=self.scale_from,
            gps=self.gps,
            wheel=self.wheel,
            offset_ns=round(1e9 * self.scale_offset),
            georeference=self.georeference,
            height_m=self.height,
            marker_length_m=length_m,
            marker_dictionary=self.marker_dictionary,
            world=self.world,
            marker_map=marker_map,
            lever_arm_m=self.lever_arm,
        )


@block(_VISUALISATION)
class Viewer:
    """Recording and streaming for the rerun viewer."""

    rrd: Path | None = option(
        "Record for the rerun viewer to this file, for `vo view`.", default=None, metavar="FILE"
    )
    rrd_images: ImageSize = option("Size of the images in the viewer.", default=ImageSize.HALF)
    spawn: bool = option("Open a rerun viewer and stream to it.", "--spawn", default=False)
    connect: str | None = option(
        "Stream to a running rerun viewer.", default=None, metavar="HOST:PORT"
    )
    serve: bool = option(
        "Stream to a web page for a browser on this machine.", "--serve", default=False
    )


@block(OUTPUT)
class Outputs:
    """Files and text to write beside the results."""

    save_map: Path | None = option(
        "Also write the stored keyframes and their poses, for --map and vo map.",
        default=None,
        metavar="FILE",
    )
    save_calibration: Path | None = option(
        "Write the calibration that is used to this file, such as one estimated from the images.",
        default=None,
        metavar="FILE",
    )
    mcap: Path | None = option(
        "Also write an MCAP file for Foxglove.", default=None, metavar="FILE"
    )
    colmap: Path | None = option(
        "Also write keyframes, their images and points as a COLMAP model.",
        default=None,
        metavar="FOLDER",
    )
    ply: Path | None = option(
        "Also write the points of the map as a PLY file.", default=None, metavar="FILE"
    )
    dense: bool = option(
        "Afterwards also make a cloud, a mesh and a grid in OUTPUT/dense, as vo dense does.",
        "--dense",
        default=False,
    )
    poses: list[str] | None = option(
        "Send each pose at once: - (JSON lines on standard output), udp://HOST:PORT, or "
        "ws://HOST:PORT (a server for Foxglove; ws://:8765 for this machine alone); "
        "repeatable.",
        default=None,
        metavar="-|ADDRESS",
    )
    allow_origin: list[str] | None = option(
        "A web page, such as https://example.org, that may read the poses of ws://, besides those "
        "of this machine and of Foxglove; repeatable.",
        default=None,
        metavar="ORIGIN",
    )
    profile: bool = option(
        "Print the time spent in each stage, and save it in summary.json.",
        "--profile",
        default=False,
    )
    fail_under: str | None = option(
        "Exit with status 4 if fewer frames have a pose, such as 90%, or if the path is "
        "not to be trusted.",
        default=None,
        metavar="PERCENT",
    )

    @property
    def exports(self) -> Exports:
        """The files for other programs, which have options of their names."""
        from vo.outputs.recorders.exports import Exports

        return Exports(**{each.name: getattr(self, each.name) for each in fields(Exports)})

    @property
    def poses_on_standard_output(self) -> bool:
        """Whether nothing else may be written there."""
        return "-" in (self.poses or ())
