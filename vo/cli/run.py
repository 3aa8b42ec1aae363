"""`vo run`: from a recording to the camera's path."""

from __future__ import annotations

import time
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


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
            help="Recording: an MCAP file (- takes one through a pipe), a ROS bag, a video, a "
            "folder of KITTI, KITTI raw, EuRoC or TUM RGB-D, a folder of images (or of left/ and "
            "right/), or a pattern in quotes.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder for the results; made if it is missing."),
    ],
    config: Annotated[
        str | None,
        typer.Option(help="Preset (default, fast, accurate) or YAML file.", show_default="default"),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="SECTION.KEY=VALUE",
            help="Change one setting, stronger than the file; may be given again.",
        ),
    ] = None,
    mode: Annotated[
        ModeChoice,
        typer.Option(
            help="mono ignores the right camera, stereo insists on it, auto uses it if it is there."
        ),
    ] = ModeChoice.AUTO,
    start: Annotated[int, typer.Option(min=0, help="First frame, counted from 0.")] = 0,
    end: Annotated[
        int | None,
        typer.Option(min=0, help="Frame to stop before.", show_default="the last"),
    ] = None,
    stride: Annotated[int, typer.Option(min=1, help="Take every so many frames.")] = 1,
    rrd: Annotated[
        Path | None, typer.Option(help="Record for the rerun viewer into this file.")
    ] = None,
    rrd_images: Annotated[
        ImageSize, typer.Option(help="Size of the images in the recording.")
    ] = ImageSize.HALF,
    connect: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Stream to the rerun viewer that runs there."),
    ] = None,
    spawn: Annotated[
        bool, typer.Option("--spawn", help="Open a rerun viewer and stream to it.")
    ] = False,
    serve: Annotated[
        bool, typer.Option("--serve", help="Stream to a page for the browser of this machine.")
    ] = False,
    mcap: Annotated[
        Path | None, typer.Option(help="Record for Foxglove into this MCAP file.")
    ] = None,
    colmap: Annotated[
        Path | None,
        typer.Option(help="Write keyframes, their images and points as a COLMAP model here."),
    ] = None,
    ply: Annotated[Path | None, typer.Option(help="Write the map's points into this file.")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Calibration file instead of the recording's own."),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            help="Format of the recording: mcap, rosbag1, rosbag2, kitti, kitti_raw, euroc, tum, "
            "video, glob, folder.",
            show_default="found out from its files",
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            help="Topic of a log: left=/cam0/image and right=/cam1/image, or one name alone; may "
            "be given again.",
            show_default="found out",
        ),
    ] = None,
    follow: Annotated[
        bool,
        typer.Option(
            "--follow",
            help="The MCAP file is still being written: take frames as they come, until it is "
            "closed or has not grown for 10 s.",
        ),
    ] = False,
    threads: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Cores to work on; the result is the same with any number.",
            show_default="all",
        ),
    ] = None,
    profile: Annotated[
        bool,
        typer.Option("--profile", help="Say where the time went, here and in summary.json."),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print warnings and errors only.")
    ] = False,
) -> None:
    """Compute a camera's path from a recording.

    The folder gets trajectory.tum (smoothed), causal.tum (as known at
    the time), covariance.csv, summary.json and config.yaml, in the place
    of those of an earlier run. They are written as the run goes: Ctrl-C
    keeps what was computed. Frames that cannot be placed are listed in
    the summary, never made up.

    A recording with two cameras, to be looked at with rerun:

      vo run my_sequence/ --output out/ --rrd out/run.rrd

    Its left camera only, the first 500 frames, with more features:

      vo run my_sequence/ -o out/ --mode mono --end 500 --set features.count=2500

    Images of your own camera (docs/calibration.md shows the file):

      vo run images/ -o out/ --calibration camera.yaml

    Exit status: 0 done, also if nothing could be tracked (a warning says
    so), 1 error, 2 wrong use, 130 stopped by Ctrl-C.
    """
    begun = _process_begun()
    try:
        from rich.console import Console

        from vo.cli.live import live_viewer
        from vo.cli.progress import make_progress, warnings_on
        from vo.cli.run_table import print_summary
        from vo.cli.standard_input import spooled_input
        from vo.config import load_config
        from vo.recording.exports import Exports
        from vo.run import run

        settings = list(overrides or ())
        if threads is not None:
            settings.append(f"threads={threads}")
        console = Console(stderr=True, highlight=False)
        watched = live_viewer(connect, spawn=spawn, serve=serve)
        through_pipe = str(source) == "-"
        origin = spooled_input() if through_pipe else nullcontext(source)
        with warnings_on(console), watched as viewer, origin as path:
            summary = run(
                path,
                output,
                config=load_config(config or "default", settings),
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
                progress=make_progress(console, quiet=quiet),
                profile_since=begun if profile else None,
            )
            if not quiet:
                print_summary(summary, output, rrd)
    except KeyboardInterrupt:
        typer.echo(f"interrupted; what was computed until now is in {output}", err=True)
        raise typer.Exit(130) from None


def _process_begun() -> float:
    """When this process was started, on the clock of `time.perf_counter`."""
    from vo.results.environment import process_age_s

    return time.perf_counter() - (process_age_s() or 0.0)
