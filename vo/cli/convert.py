"""`vo convert`: a recording in another layout, size or codec."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vo.cli.run import ModeChoice

if TYPE_CHECKING:
    from rich.console import Console

    from vo.cli.conversion import Conversion
    from vo.inspection.opening import OpenedRecording


def convert_command(
    source: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Anything that `vo run` takes.")
    ],
    output: Annotated[
        Path, typer.Argument(metavar="OUTPUT", help="Folder to make, or a file that ends in .mcap.")
    ],
    format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2.",
            show_default="mcap for .mcap, else euroc",
        ),
    ] = None,
    codec: Annotated[
        str, typer.Option(metavar="CODEC", help="Of the images: png, jpeg (loses), or raw in MCAP.")
    ] = "png",
    start: Annotated[
        int, typer.Option(min=0, metavar="N", help="First frame, counted from 0.")
    ] = 0,
    end: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Frame to stop before.", show_default="the last"),
    ] = None,
    stride: Annotated[int, typer.Option(min=1, metavar="N", help="Take every N-th frame.")] = 1,
    resize: Annotated[
        str | None,
        typer.Option(
            metavar="WxH|FACTOR",
            help="Scale images and calibration, to 640x400 or by 0.5.",
        ),
    ] = None,
    gray: Annotated[
        bool, typer.Option("--gray", help="Grey images with 8 bits, as the odometry sees them.")
    ] = False,
    mode: Annotated[
        ModeChoice, typer.Option(help="mono leaves the right camera out.")
    ] = ModeChoice.AUTO,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Calibration instead of the recording's own."),
    ] = None,
    source_format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Of the recording, as --format of `vo run`.",
            show_default="found out from its files",
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOPIC",
            help="Camera of a log, as for `vo run`; may be given again.",
            show_default="found out from the names",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Write a recording in another layout, shorter or smaller.

    Images stay as they were recorded, in colour and with 16 bits, unless
    --gray or --codec jpeg says otherwise; stamps, calibration, depth, truth
    and (EuRoC, MCAP) inertial measurements come along. It appears when it is
    whole.

      vo convert log.mcap out/euroc --start 100 --end 600

      vo convert kitti/06 small.mcap --resize 0.5 --codec jpeg --format mcap-ros2
    """
    from rich.console import Console

    from vo.cli.conversion import Conversion
    from vo.cli.progress import warnings_on
    from vo.inspection.opening import open_leniently
    from vo.results.claim import refuse_to_overwrite

    refuse_to_overwrite((source, calibration), (output,))
    console = Console(stderr=True, highlight=False, quiet=quiet)
    how = Conversion(_format(format, output), codec, start, end, stride, _size(resize), gray)
    opened = open_leniently(
        source, format=source_format, calibration=calibration, mode=mode.value, topics=topic or ()
    )
    for line in opened.warnings:
        console.print(f"warning: {line}", markup=False, soft_wrap=True)
    try:
        with warnings_on(console):
            _convert(opened, output, how, force, console)
    except KeyboardInterrupt:
        typer.echo(f"interrupted; {output} was not written", err=True)
        raise typer.Exit(130) from None


def _convert(
    opened: OpenedRecording, output: Path, how: Conversion, force: bool, console: Console
) -> None:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from vo.cli.conversion import convert

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    still = console.quiet or not console.is_terminal
    with Progress(*columns, console=console, disable=still, transient=True) as bar:
        task = bar.add_task("converting", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        made = convert(opened, output, how, force=force, on_frame=show)
    kind = "stereo" if made.rig.is_stereo else "mono"
    camera = made.rig.cam0
    truth = f"{len(made.body_truth.stamps_ns)} true poses"
    imu = "" if made.imu is None else f", {len(made.imu.stamps_ns)} inertial samples"
    if not console.quiet:
        typer.echo(
            f"{output}: {len(made.stamps_ns[0])} {kind} frames, {camera.width}x{camera.height} "
            f"{'colour' if made.has_colour else 'grey'}, {how.format} ({how.codec}), {truth}{imu}"
        )


def _format(format: str | None, output: Path) -> str:
    from data_synth.writers.registry import FORMATS
    from vo.errors import ConfigError

    is_file = output.suffix.lower() == ".mcap"
    chosen = format or ("mcap" if is_file else "euroc")
    if chosen not in FORMATS:
        raise ConfigError(f"format '{chosen}' cannot be written; {', '.join(FORMATS)} can")
    if bool(FORMATS[chosen].suffix) != is_file:
        wanted = "a file that ends in .mcap" if FORMATS[chosen].suffix else "a folder"
        raise ConfigError(f"format {chosen} is {wanted}, and {output} is not")
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
        raise ConfigError(f"--resize {text} is neither a size such as 640x400 nor a factor as 0.5")
    return factor
