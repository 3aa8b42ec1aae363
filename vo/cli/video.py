"""`vo video`: a run as a video."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import SourceError
from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo

if TYPE_CHECKING:
    from vo.cli.options import Printing
    from vo.outputs.report.run_folder import RunRecord
    from vo.tools.rendering.film import FilmRecorder


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
    from vo.outputs.report.run_folder import read_run
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.rendering.film import FilmOptions, FilmRecorder

    chosen = FilmOptions(width, speed, start, end)
    record = read_run(run)
    recording = str(record.summary["source"]) if source is None else source
    refuse_to_overwrite([Path(recording)], [output])
    recorder = FilmRecorder(record, output, chosen)
    try:
        _track_again(record, recording, recorder, printing)
    finally:
        recorder.close()
    done = recorder.result()
    if not done.images:
        raise SourceError(f"{recording}: no frame of the run could be read; name its recording")
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


def _track_again(
    record: RunRecord, recording: str, recorder: FilmRecorder, printing: Printing
) -> None:
    """Track the recording of a run with its settings, and draw it."""
    from vo.base.config import load_config
    from vo.cli.progress import make_progress
    from vo.runs.run_recording import run as track

    summary = record.summary
    calibration = summary.get("calibration")
    with tempfile.TemporaryDirectory(prefix="vo-video-") as folder:
        track(
            recording,
            Path(folder),
            config=load_config(record.path / "config.yaml"),
            mode="mono" if summary["mode"] == "mono" else "auto",
            start=int(summary["start"]),
            end=recorder.end,
            stride=int(summary["stride"]),
            calibration=None if calibration is None else Path(calibration),
            format=str(summary["format"]),
            topics=tuple(summary.get("topics", ())),
            right_offset_ns=summary.get("right_offset_ns"),
            recorder=recorder,
            progress=make_progress(printing.errors, quiet=printing.quiet),
        )
