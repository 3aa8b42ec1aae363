"""`vo convert`: recordings in another format, size or codec."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vo.cli import completion, options
from vo.cli.echo import echo

if TYPE_CHECKING:
    from rich.console import Console

    from vo.cli.conversion import Conversion
    from vo.inspection.opening import OpenedRecording


Output = Annotated[
    Path, typer.Argument(metavar="OUTPUT", help="Folder to create, or a file ending in .mcap.")
]
Codec = Annotated[
    str,
    typer.Option(
        metavar="CODEC",
        help="Image codec: png, jpeg (lossy), or raw in MCAP.",
        autocompletion=completion.codecs,
        rich_help_panel=options.OUTPUT,
    ),
]
Resize = Annotated[
    str | None,
    typer.Option(
        metavar="WxH|FACTOR",
        help="Scale images and calibration, for example to 640x400 or by 0.5.",
        rich_help_panel=options.OUTPUT,
    ),
]
Gray = Annotated[
    bool,
    typer.Option(
        "--gray",
        help="Write 8-bit grey images, as used by the odometry.",
        rich_help_panel=options.OUTPUT,
    ),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace an existing file.", rich_help_panel=options.OUTPUT),
]


def convert_command(
    source: options.Recording,
    output: Output,
    to: options.OutputFormat = None,
    codec: Codec = "png",
    start: options.Start = 0,
    end: options.End = None,
    stride: options.Stride = 1,
    resize: Resize = None,
    gray: Gray = False,
    mode: options.Mode = options.ModeChoice.AUTO,
    calibration: options.Calibration = None,
    format: options.Format = None,
    topic: options.Topics = None,
    right_offset: options.RightOffset = None,
    force: Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Convert a recording to another format, size or length.

    Images keep their colour and bit depth unless --gray or --codec jpeg is
    given. Stamps, calibration, depth, ground truth and (EuRoC, MCAP) inertial
    measurements are included. The output appears when it is complete.

    Write 500 frames of a log as an EuRoC folder:

      vo convert log.mcap out/euroc --start 100 --end 600

    Make a small copy in another format:

      vo convert kitti/06 small.mcap --resize 0.5 --codec jpeg --to mcap-ros2
    """
    from vo.cli.console import standard_error
    from vo.cli.conversion import Conversion
    from vo.cli.progress import warnings_on
    from vo.inspection.opening import open_leniently
    from vo.results.output_paths import refuse_to_overwrite

    refuse_to_overwrite((source, calibration), (output,))
    console = standard_error(quiet=quiet)
    chosen = _output_format(to, output)
    settings = Conversion(chosen, codec, start, end, stride, _size(resize), gray)
    opened = open_leniently(
        source,
        format=format,
        calibration=calibration,
        mode=mode.value,
        topics=topic or (),
        right_offset_ns=options.offset_ns(right_offset),
    )
    for warning in opened.warnings:
        console.print(f"warning: {warning.text}", markup=False, soft_wrap=True)
    try:
        with warnings_on(console):
            _convert(opened, output, settings, force, console)
    except KeyboardInterrupt:
        echo(f"interrupted; {output} was not written", err=True)
        raise typer.Exit(130) from None


def _convert(
    opened: OpenedRecording, output: Path, settings: Conversion, force: bool, console: Console
) -> None:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from vo.cli.conversion import convert

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    is_hidden = console.quiet or not console.is_terminal
    with Progress(*columns, console=console, disable=is_hidden, transient=True) as bar:
        task = bar.add_task("converting", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        made = convert(opened, output, settings, force=force, on_frame=show)
    kind = "stereo" if made.rig.is_stereo else "mono"
    camera = made.rig.cam0
    truth = f"{len(made.body_truth.stamps_ns)} ground truth poses"
    imu = "" if made.imu is None else f", {len(made.imu.stamps_ns)} inertial samples"
    if not console.quiet:
        echo(
            f"{output}: {len(made.stamps_ns[0])} {kind} frames, {camera.width}x{camera.height} "
            f"{'colour' if made.has_colour else 'grey'}, {settings.format} ({settings.codec}), "
            f"{truth}{imu}"
        )


def _output_format(format: str | None, output: Path) -> str:
    from data_synth.writers.registry import FORMATS
    from vo.errors import ConfigError

    is_file = output.suffix.lower() == ".mcap"
    chosen = format or ("mcap" if is_file else "euroc")
    if chosen not in FORMATS:
        raise ConfigError(f"cannot write format '{chosen}'; use one of {', '.join(FORMATS)}")
    if bool(FORMATS[chosen].suffix) != is_file:
        kind = "a file ending in .mcap" if FORMATS[chosen].suffix else "a folder"
        raise ConfigError(f"format {chosen} needs {kind} as output, not {output}")
    return chosen


def _size(text: str | None) -> tuple[int, int] | float | None:
    from vo.errors import ConfigError

    if text is None:
        return None
    sides = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if sides is not None and min(int(sides[1]), int(sides[2])) > 0:
        return int(sides[1]), int(sides[2])
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.01 <= factor <= 10.0:
        raise ConfigError(
            f"invalid --resize {text}; use a size such as 640x400, or a factor such as 0.5"
        )
    return factor
