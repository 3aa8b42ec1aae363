"""`vo convert`: recordings in another format, size or codec."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from vo.base.printable import counted
from vo.cli import completion, options
from vo.cli.blocks import Only, argument, option
from vo.cli.echo import echo
from vo.cli.stopping import interrupts_named

if TYPE_CHECKING:
    from rich.console import Console

    from data_synth.records import Recording
    from vo.api.conversion import Conversion
    from vo.tools.inspection.opening import OpenedRecording


def convert_command(
    source: options.Recording,
    output: Path = argument("Folder to create, or a file ending in .mcap.", metavar="OUTPUT"),
    *,
    to: str | None = option(
        "Format to write: euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2.",
        default=None,
        metavar="FORMAT",
        show_default="mcap for .mcap, else euroc",
        autocompletion=completion.output_formats,
        panel=options.OUTPUT,
    ),
    codec: str = option(
        "Image codec: png, jpeg (lossy), or raw in MCAP.",
        default="png",
        metavar="CODEC",
        autocompletion=completion.codecs,
        panel=options.OUTPUT,
    ),
    frames: options.Frames,
    resize: str | None = option(
        "Scale images and calibration, for example to 640x400 or by 0.5.",
        default=None,
        metavar="WxH|FACTOR",
        panel=options.OUTPUT,
    ),
    gray: bool = option(
        "Write 8-bit grey images, as used by the odometry.",
        "--gray",
        default=False,
        panel=options.OUTPUT,
    ),
    reading: Annotated[
        options.Reading, Only("mode", "calibration", "format", "topic", "right_offset")
    ],
    force: bool = option(
        "Replace an existing file.", "--force", default=False, panel=options.OUTPUT
    ),
    printing: options.Printing,
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
    from vo.api.conversion import Conversion
    from vo.api.conversion_choices import output_format, size_of
    from vo.cli.console import standard_error
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.inspection.opening import open_leniently

    refuse_to_overwrite((source, reading.calibration), (output,))
    console = standard_error()
    chosen = output_format(to, output)
    settings = Conversion(
        chosen, codec, frames.start, frames.end, frames.stride, size_of(resize), gray
    )
    with printing.details():
        opened = open_leniently(source, **reading.keywords)
    for warning in opened.warnings:
        console.print(f"warning: {warning.text}", markup=False, soft_wrap=True)
    with interrupts_named(output), printing.warnings():
        made = _convert(opened, output, settings, force, printing.errors)
    facts = _facts(made, output, settings)
    printing.show(lambda: facts, lambda: echo(_sentence(facts)))


def _convert(
    opened: OpenedRecording, output: Path, settings: Conversion, force: bool, console: Console
) -> Recording:
    from vo.api.conversion import convert
    from vo.cli.progress import frame_bar

    with frame_bar(console, "converting") as (_, show):
        return convert(opened, output, settings, force=force, on_frame=show)


def _facts(made: Recording, output: Path, settings: Conversion) -> dict[str, Any]:
    from vo.outputs.results.summary import mode_of

    return {
        "output": str(output),
        "format": settings.format,
        "codec": settings.codec,
        "mode": mode_of(made.rig) if made.rig.is_stereo else "mono",
        "cameras": len(made.rig.cameras),
        "frames": len(made.stamps_ns[0]),
        "width": made.rig.cam0.width,
        "height": made.rig.cam0.height,
        "colour": made.has_colour,
        "ground_truth_poses": len(made.body_truth.stamps_ns),
        "inertial_samples": 0 if made.imu is None else len(made.imu.stamps_ns),
    }


def _sentence(facts: dict[str, Any]) -> str:
    samples = facts["inertial_samples"]
    imu = f", {counted(samples, 'inertial sample')}" if samples else ""
    return (
        f"{facts['output']}: {counted(facts['frames'], facts['mode'] + ' frame')}, "
        f"{facts['width']}x{facts['height']} {'colour' if facts['colour'] else 'grey'}, "
        f"{facts['format']} ({facts['codec']}), "
        f"{counted(facts['ground_truth_poses'], 'ground truth pose')}{imu}"
    )
