"""`vo video`: a run as a video."""

from __future__ import annotations

from pathlib import Path

from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo


def video_command(
    run: Path = argument("Folder of a run.", metavar="RUN"),
    source: str | None = argument(
        "Recording of the run.", default=None, metavar="SOURCE", show_default="where it was"
    ),
    *,
    output: Path = option(
        "Video (.mp4, .mkv, .mov, .avi).",
        "--output",
        "-o",
        default=Path("run.mp4"),
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    width: int = option(
        "Width in pixels.", default=1280, metavar="PIXELS", min=320, max=7680, panel=options.OUTPUT
    ),
    speed: float = option(
        "Speed, 2 for twice that of the recording.",
        default=1.0,
        metavar="FACTOR",
        min=0.01,
        max=1000.0,
        panel=options.OUTPUT,
    ),
    start: int | None = option(
        "First frame to show.", default=None, metavar="N", min=0, panel=options.INPUT
    ),
    end: int | None = option(
        "Frame to stop before.", default=None, metavar="N", min=0, panel=options.INPUT
    ),
    printing: options.Printing,
) -> None:
    """Show a run as a video: features and matches, and beside them the path.

    The frames are tracked again with the settings of the run, which gives
    the same features; the path is that of the run. The frame of the images
    is green, and red where tracking is lost.

    Of a run whose recording has been moved, at four times the speed:

      vo video out/ my_sequence/ -o talk.mp4 --speed 4
    """
    from vo.api.video import video
    from vo.cli.progress import make_progress

    progress = make_progress(printing.errors, quiet=printing.quiet)
    done = video(
        run, source, output, width=width, speed=speed, start=start, end=end, progress=progress
    )
    if done.differing:
        echo(
            f"warning: {done.differing} of {done.frames} frames were tracked in another way than "
            "in the run (inputs that only its command line named, or another version); the path is "
            "that of the run",
            err=True,
        )
    text = f"output      {done.output}\n"
    text += f"images      {done.images} of {done.frames} frames, {done.rate:g} per second\n"
    text += f"lost        {done.lost}"
    printing.show(lambda: {**done._asdict(), "output": str(done.output)}, lambda: echo(text))
