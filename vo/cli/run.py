"""`vo run`: from a recording to the camera's path."""

from __future__ import annotations

import time
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

# Headings of `--help`, where each option stands under one.
_INPUT, _ODOMETRY = "What is read", "How it is computed"
_LOOK, _OUTPUT = "To look at it with rerun", "What is written"


class ImageSize(StrEnum):
    """Choices of `--rrd-images`."""

    FULL = "full"
    HALF = "half"
    NONE = "none"


class ModeChoice(StrEnum):
    """Choices of `--mode`."""

    AUTO = "auto"
    MONO = "mono"
    STEREO = "stereo"


def run_command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="An MCAP file (- takes one through a pipe), a ROS bag, a video, a folder of "
            "KITTI, KITTI raw, EuRoC or TUM RGB-D, a folder of images (or of left/ and right/), "
            "or a pattern in quotes.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Folder for the results; made if it is missing.",
            rich_help_panel=_OUTPUT,
        ),
    ],
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Calibration instead of the recording's own: that of Kalibr, ROS, OpenCV, "
            "ORB-SLAM3, Basalt, COLMAP, KITTI, or your own (docs/calibration.md).",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    mode: Annotated[
        ModeChoice,
        typer.Option(
            help="mono ignores the right camera, stereo insists on it, auto uses it if it is "
            "there.",
            rich_help_panel=_INPUT,
        ),
    ] = ModeChoice.AUTO,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOPIC",
            help="Camera of a log: left=/cam0/image and right=/cam1/image, or one name alone; may "
            "be given again. Found out from the names otherwise.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="mcap, rosbag1, rosbag2, kitti, kitti_raw, euroc, tum, video, glob or folder. "
            "Found out from the files otherwise.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    follow: Annotated[
        bool,
        typer.Option(
            "--follow",
            help="The MCAP file is still being written: take frames as they come, until it is "
            "closed or has not grown for 10 s.",
            rich_help_panel=_INPUT,
        ),
    ] = False,
    start: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="First frame, counted from 0.",
            rich_help_panel=_INPUT,
        ),
    ] = 0,
    end: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Frame to stop before; the last is taken otherwise.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    stride: Annotated[
        int,
        typer.Option(min=1, metavar="N", help="Take every N-th frame.", rich_help_panel=_INPUT),
    ] = 1,
    config: Annotated[
        str,
        typer.Option(
            metavar="PRESET|FILE",
            help="default, fast or accurate, or a YAML file as configs/default.yaml.",
            rich_help_panel=_ODOMETRY,
        ),
    ] = "default",
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="SECTION.KEY=VALUE",
            help="Change one setting, stronger than the file; may be given again.",
            rich_help_panel=_ODOMETRY,
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Cores to work on, all by default (0); the result is the same with any number.",
            rich_help_panel=_ODOMETRY,
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Record for the rerun viewer into this file; `vo view` opens it.",
            rich_help_panel=_LOOK,
        ),
    ] = None,
    rrd_images: Annotated[
        ImageSize,
        typer.Option(help="Size of the images that rerun gets.", rich_help_panel=_LOOK),
    ] = ImageSize.HALF,
    spawn: Annotated[
        bool,
        typer.Option(
            "--spawn", help="Open a rerun viewer and stream to it.", rich_help_panel=_LOOK
        ),
    ] = False,
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Stream to the rerun viewer that runs there.",
            rich_help_panel=_LOOK,
        ),
    ] = None,
    serve: Annotated[
        bool,
        typer.Option(
            "--serve",
            help="Stream to a page for the browser of this machine.",
            rich_help_panel=_LOOK,
        ),
    ] = False,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the run for Foxglove into this MCAP file.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    colmap: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write keyframes, their images and points as a COLMAP model here.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    ply: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the map's points into this file.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    profile: Annotated[
        bool,
        typer.Option(
            "--profile",
            help="Say where the time went, here and in summary.json.",
            rich_help_panel=_OUTPUT,
        ),
    ] = False,
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet", "-q", help="Print warnings and errors only.", rich_help_panel=_OUTPUT
        ),
    ] = False,
) -> None:
    """Compute a camera's path from a recording.

    The folder gets trajectory.tum (smoothed), causal.tum (as known at
    the time), poses.csv, covariance.csv, frames.csv, summary.json and
    config.yaml, in the place of those of an earlier run. They are written
    as the run goes: Ctrl-C keeps what was computed. Frames that cannot be
    placed are listed in the summary, never made up.

    A recording with two cameras, to be looked at with rerun:

      vo run my_sequence/ --output out/ --rrd out/run.rrd

    Its left camera only, the first 500 frames, with more features:

      vo run my_sequence/ -o out/ --mode mono --end 500 --set features.count=2500

    Images of your own camera (docs/calibration.md shows the file):

      vo run images/ -o out/ --calibration camera.yaml

    Exit status: 0 done, also if nothing could be tracked (a warning says
    so), 1 error, 2 wrong use, 130 stopped by Ctrl-C, 143 by kill.
    """
    begun = _process_begun()
    from vo.cli.loading import loading
    from vo.cli.stopping import stops_gently

    with stops_gently(output), ExitStack() as stack:
        with loading():
            from vo.backend.launch import child_started_early
            from vo.config import load_config
            from vo.cores import available_cores

            settings = list(overrides or ())
            if threads is not None:
                settings.append(f"threads={threads}")
            merged = load_config(config, settings)
            # Two processes load at the same time, instead of one after the other.
            cores = merged.threads or available_cores()
            child = stack.enter_context(child_started_early(cores))

            from vo.cli.console import standard_error
            from vo.cli.live import live_viewer
            from vo.cli.progress import make_progress, warnings_on
            from vo.cli.run_table import print_summary
            from vo.cli.standard_input import NAME, spooled_input
            from vo.recording.exports import Exports
            from vo.run import run

        console = standard_error()
        stack.enter_context(warnings_on(console))
        viewer = stack.enter_context(live_viewer(connect, spawn=spawn, serve=serve))
        through_pipe = str(source) == "-"
        path = stack.enter_context(spooled_input()) if through_pipe else source
        summary = run(
            path,
            output,
            config=merged,
            mode=mode.value,
            start=start,
            end=end,
            stride=stride,
            rrd=rrd,
            exports=Exports(mcap=mcap, colmap=colmap, ply=ply),
            rrd_images=rrd_images.value,
            viewer=viewer,
            calibration=calibration,
            format=format,
            topics=topic or (),
            follow=follow or through_pipe,
            source_name=NAME if through_pipe else None,
            progress=make_progress(console, quiet=quiet),
            profile_since=begun if profile else None,
            smoother_process=child,
        )
        if not quiet:
            print_summary(summary, output, rrd)


def _process_begun() -> float:
    """When this process was started, on the clock of `time.perf_counter`."""
    from vo.results.environment import process_age_s

    return time.perf_counter() - (process_age_s() or 0.0)
