"""Arguments and options shared by several commands, so that they read the same everywhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vo.cli import completion
from vo.cli.blocks import block, option
from vo.cli.echo import echo_json

if TYPE_CHECKING:
    from rich.console import Console

# Headings of the options in `--help`.
INPUT, OUTPUT, ODOMETRY = "Input", "Output", "Odometry"


_MAX_OFFSET_MS = 1e12  # 30 years


def offset_ns(right_offset_ms: float | None) -> int | None:
    """`--right-offset` in nanoseconds, None if it was not given.

    Raises:
        ConfigError: it is not a usual number.
    """
    from vo.base.errors import ConfigError

    if right_offset_ms is None:
        return None
    if not abs(right_offset_ms) <= _MAX_OFFSET_MS:
        raise ConfigError(f"--right-offset is {right_offset_ms:g}; give milliseconds, such as -50")
    return round(1e6 * right_offset_ms)


class ModeChoice(StrEnum):
    """Choices of `--mode`."""

    AUTO = "auto"
    MONO = "mono"
    STEREO = "stereo"


Recording = Annotated[
    Path, typer.Argument(metavar="RECORDING", help="Recording in any format of `vo run`.")
]

Calibration = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Calibration to use instead of the recording's own: Kalibr, ROS, OpenCV, ORB-SLAM3, "
        "Basalt, COLMAP, KITTI, or the format in docs/calibration.md.",
        rich_help_panel=INPUT,
    ),
]


Config = Annotated[
    str,
    typer.Option(
        metavar="PRESET|FILE",
        help="default, fast, accurate or best, or a YAML file like configs/default.yaml.",
        autocompletion=completion.presets,
        rich_help_panel=ODOMETRY,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="SECTION.KEY=VALUE",
        help="Override a setting of --config; repeatable.",
        rich_help_panel=ODOMETRY,
    ),
]


@block(INPUT)
class Reading:
    """How a recording is opened."""

    calibration: Calibration = None
    mode: ModeChoice = option(
        "mono: only the left camera; stereo: require both; auto: both if available.",
        default=ModeChoice.AUTO,
    )
    topic: list[str] | None = option(
        "Image topic of a log: left=/cam0/image and right=/cam1/image, or the names of all "
        "cameras in their order; repeatable.",
        default=None,
        metavar="TOPIC",
        show_default="detected from the names",
        autocompletion=completion.image_topics,
    )
    right_offset: float | None = option(
        "Milliseconds to add to the stamps of right images before they are paired; negative "
        "if they are stamped too late.",
        default=None,
        metavar="MS",
        show_default="0, or the constant offset of all right stamps",
    )
    format: str | None = option(
        "Format of the recording: mcap, rosbag1, rosbag2, kitti, kitti_raw, 4seasons, euroc, "
        "tum, tartanair, nerf, nuscenes, video, glob or folder.",
        default=None,
        metavar="FORMAT",
        show_default="detected from the files",
        autocompletion=completion.input_formats,
    )
    side_by_side: bool = option(
        "Each image has the left and the right one beside each other (video, folder of "
        "images, live camera).",
        "--side-by-side",
        default=False,
    )

    @property
    def topics(self) -> tuple[str, ...]:
        """`--topic`, without any if it was not given."""
        return tuple(self.topic or ())

    @property
    def right_offset_ns(self) -> int | None:
        """`--right-offset` in nanoseconds, None if it was not given."""
        return offset_ns(self.right_offset)

    @property
    def keywords(self) -> dict[str, Any]:
        """Arguments of `open_source` and others that open recordings."""
        names = ("calibration", "format", "topics", "right_offset_ns")
        return {"mode": self.mode.value} | {name: getattr(self, name) for name in names}


@block(INPUT)
class Frames:
    """The frames to use."""

    start: int = option("First frame, counted from 0.", default=0, min=0, metavar="N")
    end: int | None = option(
        "Stop before this frame.",
        default=None,
        min=0,
        metavar="N",
        show_default="end of the recording",
    )
    stride: int = option("Use every N-th frame.", default=1, min=1, metavar="N")


@block(INPUT)
class MaskOptions:
    """Areas of the images that are not used."""

    mask: list[str] | None = option(
        "Image of the size of the recorded (not rectified) images: where it is black (0) "
        "they are not used, elsewhere they are. Stereo: --mask left.png --mask right.png.",
        default=None,
        metavar="FILE",
    )
    ignore: list[str] | None = option(
        "Do not use this area, such as the robot's own body or burnt-in text: x,y,width,"
        "height or a polygon x1,y1,x2,y2,x3,y3,…, in pixels of the recorded left image; right: or "
        "both: before it for others. Repeatable.",
        default=None,
        metavar="AREA",
    )
    roi: list[str] | None = option(
        "Use only this area (region of interest); as --ignore.", default=None, metavar="AREA"
    )

    @property
    def settings(self) -> list[str]:
        """The settings that they override."""
        given = {"files": self.mask, "ignore": self.ignore, "roi": self.roi}
        return [f"masks.{key}={json.dumps(texts)}" for key, texts in given.items() if texts]


@block(OUTPUT)
class Printing:
    """What a command prints of its result and its progress."""

    json_output: bool = option(
        "Print JSON on standard output instead of text.", "--json", default=False
    )
    quiet: bool = option(
        "Print only warnings and errors, on standard error.", "--quiet", "-q", default=False
    )
    verbose: bool = option(
        "Also print what is read and decided, on standard error.", "--verbose", "-v", default=False
    )

    def show(self, record: Callable[[], Any], text: Callable[[], None]) -> None:
        """Print a result: its record with --json, nothing with --quiet, else its text."""
        if self.json_output:
            echo_json(record())
        elif not self.quiet:
            text()

    @property
    def errors(self) -> Console:
        """The console on standard error for progress, without output with --quiet."""
        from vo.cli.console import standard_error

        return standard_error(quiet=self.quiet)

    def warnings(self) -> AbstractContextManager[None]:
        """Print warnings of the library as lines on standard error."""
        from vo.cli.console import standard_error
        from vo.cli.messages import warnings_on

        return warnings_on(standard_error, quiet=self.quiet)

    def details(self) -> AbstractContextManager[None]:
        """Print what the library reads and decides, with --verbose."""
        from vo.cli.console import standard_error
        from vo.cli.messages import details_on

        return details_on(standard_error)
