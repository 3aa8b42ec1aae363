"""Arguments and options shared by several commands, so that they read the same everywhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vo.cli import completion
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

Mode = Annotated[
    ModeChoice,
    typer.Option(
        help="mono: only the left camera; stereo: require both; auto: both if available.",
        rich_help_panel=INPUT,
    ),
]

Topics = Annotated[
    list[str] | None,
    typer.Option(
        metavar="TOPIC",
        help="Image topic of a log: left=/cam0/image and right=/cam1/image, or a single name; "
        "repeatable.",
        show_default="detected from the names",
        autocompletion=completion.image_topics,
        rich_help_panel=INPUT,
    ),
]

Format = Annotated[
    str | None,
    typer.Option(
        metavar="FORMAT",
        help="Format of the recording: mcap, rosbag1, rosbag2, kitti, kitti_raw, 4seasons, euroc, "
        "tum, nerf, video, glob or folder.",
        show_default="detected from the files",
        autocompletion=completion.input_formats,
        rich_help_panel=INPUT,
    ),
]

RightOffset = Annotated[
    float | None,
    typer.Option(
        metavar="MS",
        help="Milliseconds to add to the stamps of right images before they are paired; negative "
        "if they are stamped too late.",
        show_default="0, or the constant offset of all right stamps",
        rich_help_panel=INPUT,
    ),
]

OutputFormat = Annotated[
    str | None,
    typer.Option(
        "--to",
        metavar="FORMAT",
        help="Format to write: euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2.",
        show_default="mcap for .mcap, else euroc",
        autocompletion=completion.output_formats,
        rich_help_panel=OUTPUT,
    ),
]

SideBySide = Annotated[
    bool,
    typer.Option(
        "--side-by-side",
        help="Each image has the left and the right one beside each other (video, folder of "
        "images, live camera).",
        rich_help_panel=INPUT,
    ),
]

Masks = Annotated[
    list[str] | None,
    typer.Option(
        "--mask",
        metavar="FILE",
        help="Image of the size of the recorded (not rectified) images: where it is black (0) "
        "they are not used, elsewhere they are. Stereo: --mask left.png --mask right.png.",
        rich_help_panel=INPUT,
    ),
]
Ignored = Annotated[
    list[str] | None,
    typer.Option(
        "--ignore",
        metavar="AREA",
        help="Do not use this area, such as the robot's own body or burnt-in text: x,y,width,"
        "height or a polygon x1,y1,x2,y2,x3,y3,…, in pixels of the recorded left image; right: or "
        "both: before it for others. Repeatable.",
        rich_help_panel=INPUT,
    ),
]
Regions = Annotated[
    list[str] | None,
    typer.Option(
        "--roi",
        metavar="AREA",
        help="Use only this area (region of interest); as --ignore.",
        rich_help_panel=INPUT,
    ),
]
Config = Annotated[
    str,
    typer.Option(
        metavar="PRESET|FILE",
        help="default, fast or accurate, or a YAML file like configs/default.yaml.",
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
Start = Annotated[
    int,
    typer.Option(min=0, metavar="N", help="First frame, counted from 0.", rich_help_panel=INPUT),
]

End = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="N",
        help="Stop before this frame.",
        show_default="end of the recording",
        rich_help_panel=INPUT,
    ),
]

Stride = Annotated[
    int,
    typer.Option(min=1, metavar="N", help="Use every N-th frame.", rich_help_panel=INPUT),
]

Json = Annotated[
    bool,
    typer.Option(
        "--json", help="Print JSON on standard output instead of text.", rich_help_panel=OUTPUT
    ),
]

Quiet = Annotated[
    bool,
    typer.Option(
        "--quiet",
        "-q",
        help="Print only warnings and errors, on standard error.",
        rich_help_panel=OUTPUT,
    ),
]

Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        help="Also print what is read and decided, on standard error.",
        rich_help_panel=OUTPUT,
    ),
]


@dataclass(frozen=True)
class Reading:
    """How a recording is opened."""

    calibration: Calibration = None
    mode: Mode = ModeChoice.AUTO
    topic: Topics = None
    right_offset: RightOffset = None
    format: Format = None
    side_by_side: SideBySide = False

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


@dataclass(frozen=True)
class Frames:
    """The frames to use."""

    start: Start = 0
    end: End = None
    stride: Stride = 1


@dataclass(frozen=True)
class MaskOptions:
    """Areas of the images that are not used."""

    mask: Masks = None
    ignore: Ignored = None
    roi: Regions = None

    @property
    def settings(self) -> list[str]:
        """The settings that they override."""
        given = {"files": self.mask, "ignore": self.ignore, "roi": self.roi}
        return [f"masks.{key}={json.dumps(texts)}" for key, texts in given.items() if texts]


@dataclass(frozen=True)
class Printing:
    """What a command prints of its result and its progress."""

    json_output: Json = False
    quiet: Quiet = False
    verbose: Verbose = False

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
        from vo.cli.progress import warnings_on

        return warnings_on(standard_error(), quiet=self.quiet)

    def details(self) -> AbstractContextManager[None]:
        """Print what the library reads and decides, with --verbose."""
        from vo.cli.console import standard_error
        from vo.cli.progress import details_on

        return details_on(standard_error())
