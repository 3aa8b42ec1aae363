"""`vo run`: visual odometry on a recording."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import memory_options, options, scale_options, viewer_options
from vo.cli.run_request import (
    ForScripts,
    Input,
    Outputs,
    RunRequest,
    Scale,
    Settings,
    Visualisation,
)

Recording = Annotated[
    str,
    typer.Argument(
        metavar="RECORDING",
        help="MCAP file (- for standard input), ROS bag, video, folder of KITTI, KITTI raw, EuRoC "
        "or TUM RGB-D, folder of images (or of left/ and right/), or a quoted glob pattern. Live: "
        "camera:0, camera:0,1 (stereo), /dev/video0, rtsp://HOST/PATH, http://HOST/PATH, "
        "realsense:, oak: or zed:.",
    ),
]
Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FOLDER",
        help="Folder for the results; created if missing.",
        rich_help_panel=options.OUTPUT,
    ),
]
Follow = Annotated[
    bool,
    typer.Option(
        "--follow",
        help="Follow an MCAP file that is still being written, until it is closed or has not "
        "grown for 10 s.",
        rich_help_panel=options.INPUT,
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        min=0.1,
        metavar="SECONDS",
        help="Live: end after this time without images.",
        show_default="10",
        rich_help_panel=options.INPUT,
    ),
]
Duration = Annotated[
    float | None,
    typer.Option(
        min=0.1,
        metavar="SECONDS",
        help="Live: end after this time.",
        show_default="until Ctrl-C",
        rich_help_panel=options.INPUT,
    ),
]
Record = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Live: also write the tracked images to an MCAP file, for another run on them.",
        rich_help_panel=options.OUTPUT,
    ),
]
Threads = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="N",
        help="Number of CPU cores to use, 0 for all; the result does not depend on it.",
        show_default="that of --config",
        rich_help_panel=options.ODOMETRY,
    ),
]
NoImu = Annotated[
    bool,
    typer.Option(
        "--no-imu",
        help="Do not use the inertial sensor of the recording.",
        rich_help_panel=options.ODOMETRY,
    ),
]
Mcap = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Also write an MCAP file for Foxglove.",
        rich_help_panel=options.OUTPUT,
    ),
]
Colmap = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Also write keyframes, their images and points as a COLMAP model.",
        rich_help_panel=options.OUTPUT,
    ),
]
Ply = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Also write the points of the map as a PLY file.",
        rich_help_panel=options.OUTPUT,
    ),
]
Poses = Annotated[
    list[str] | None,
    typer.Option(
        metavar="-|ADDRESS",
        help="Send each pose at once: - (JSON lines on standard output), udp://HOST:PORT, or "
        "ws://HOST:PORT (a server for Foxglove; ws://:8765 for this machine alone); repeatable.",
        rich_help_panel=options.OUTPUT,
    ),
]
Profile = Annotated[
    bool,
    typer.Option(
        "--profile",
        help="Print the time spent in each stage, and save it in summary.json.",
        rich_help_panel=options.OUTPUT,
    ),
]


FailUnder = Annotated[
    str | None,
    typer.Option(
        metavar="PERCENT",
        help="Exit with status 4 if fewer frames have a pose, such as 90%, or if the path is not "
        "to be trusted.",
        rich_help_panel=options.OUTPUT,
    ),
]


def run_command(
    source: Recording,
    output: Output,
    calibration: options.Calibration = None,
    mode: options.Mode = options.ModeChoice.AUTO,
    topic: options.Topics = None,
    right_offset: options.RightOffset = None,
    format: options.Format = None,
    side_by_side: options.SideBySide = False,
    follow: Follow = False,
    timeout: Timeout = None,
    duration: Duration = None,
    record: Record = None,
    start: options.Start = 0,
    end: options.End = None,
    stride: options.Stride = 1,
    mask: options.Masks = None,
    ignore: options.Ignored = None,
    roi: options.Regions = None,
    config: options.Config = "default",
    overrides: options.Overrides = None,
    threads: Threads = None,
    no_imu: NoImu = False,
    loops: memory_options.Loops = None,
    vocabulary: memory_options.Vocabulary = None,
    map_file: memory_options.Map = None,
    localize: memory_options.Localize = False,
    save_map: memory_options.SaveMap = None,
    scale_from: scale_options.ScaleFrom = None,
    scale_offset: scale_options.ScaleOffset = 0.0,
    lever_arm: scale_options.LeverArm = None,
    georeference: scale_options.Georeference = False,
    height: scale_options.Height = None,
    markers: scale_options.Markers = None,
    marker_dictionary: scale_options.MarkerDictionary = "auto",
    world: scale_options.World = None,
    rrd: viewer_options.Rrd = None,
    rrd_images: viewer_options.RrdImages = viewer_options.ImageSize.HALF,
    spawn: viewer_options.Spawn = False,
    connect: viewer_options.Connect = None,
    serve: viewer_options.Serve = False,
    mcap: Mcap = None,
    colmap: Colmap = None,
    ply: Ply = None,
    poses: Poses = None,
    profile: Profile = False,
    fail_under: FailUnder = None,
    json_output: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Estimate the trajectory of a camera from a recording.

    Writes trajectory.tum (smoothed), causal.tum (as known at each frame),
    poses.csv, covariance.csv, frames.csv, summary.json and config.yaml to the
    output folder, replacing those of an earlier run. Ctrl-C keeps the results
    so far. Frames without a pose are listed in the summary.

    Run on a stereo recording, and record the run for the rerun viewer:

      vo run my_sequence/ --output out/ --rrd out/run.rrd

    Use the left camera, the first 500 frames, and more features:

      vo run my_sequence/ -o out/ --mode mono --end 500 --set features.count=2500

    Run on images of your own camera (for the file see docs/calibration.md):

      vo run images/ -o out/ --calibration camera.yaml

    Pass each pose to another program as soon as it is known (docs/outputs.md):

      vo run my_sequence/ -o out/ --poses - | jq .world_from_cam0

    Run on a live camera until Ctrl-C (see docs/live.md):

      vo run camera:0 -o out/ --calibration camera.yaml --serve

    Keep the map of a recording, and find the poses of another one in it (see docs/memory.md):

      vo run monday/ -o monday-out/ --save-map house.map
      vo run tuesday/ -o tuesday-out/ --map house.map

    Use one camera, and get the scale from GPS (see docs/scale.md):

      vo run drive.mp4 -o out/ --mode mono --scale-from gps.nmea --georeference

    Leave out the car's own bonnet and burnt-in text (see docs/recordings.md):

      vo run drive.mp4 -o out/ --mask bonnet.png --ignore 0,0,400,24

    Use it in a script, and let it fail unless nearly all frames have a pose:

      vo run my_sequence/ -o out/ --json --fail-under 95% > summary.json

    Exit status: 0 finished, even if frames are lost (with a warning), 1 error,
    2 wrong usage, 3 no frame has a pose, 4 --fail-under is not reached,
    130 stopped by Ctrl-C, 143 by SIGTERM, 141 if the reader of --poses -
    ended before the run.
    """
    begun = _process_start()
    from vo.cli.run_execution import execute
    from vo.cli.run_status import parse_share

    topics = tuple(topic or ())
    offset_ns = round(1e9 * scale_offset)
    length_m, marker_map = scale_options.length_or_map(markers)
    if json_output and "-" in (poses or ()):
        raise typer.BadParameter("--json and --poses - both need standard output; use one of them")
    min_share = None if fail_under is None else parse_share(fail_under)
    execute(
        RunRequest(
            Input(
                source,
                calibration,
                mode.value,
                topics,
                options.offset_ns(right_offset),
                format,
                follow,
                start,
                end,
                stride,
                side_by_side,
                timeout,
                duration,
                record,
            ),
            Settings(
                config,
                tuple(overrides or ()),
                threads,
                loops,
                vocabulary,
                map_file,
                localize,
                {"files": mask or [], "ignore": ignore or [], "roi": roi or []},
                no_imu,
            ),
            Scale(
                scale_from,
                offset_ns,
                georeference,
                height,
                length_m,
                marker_dictionary,
                world,
                marker_map,
                lever_arm,
            ),
            Visualisation(rrd, rrd_images.value, spawn, connect, serve),
            Outputs(
                output,
                mcap,
                colmap,
                ply,
                begun if profile else None,
                quiet,
                tuple(poses or ()),
                save_map,
            ),
            ForScripts(json_output, min_share),
        )
    )


def _process_start() -> float:
    """Start of this process on the clock of `time.perf_counter`."""
    from vo.outputs.results.environment import process_age_s

    return time.perf_counter() - (process_age_s() or 0.0)
