"""Output format and size of a conversion, from the words of `vo convert`."""

from __future__ import annotations

import math
import re
from pathlib import Path

from data_synth.writers.registry import FORMATS
from vo.base.errors import ConfigError
from vo.recordings.sources.registry import VIDEO_SUFFIXES


def output_format(format: str | None, output: Path) -> str:
    """Format to write: as given, or by the output; raises `ConfigError`."""
    suffix = output.suffix.lower()
    if suffix in VIDEO_SUFFIXES:
        raise ConfigError(
            f"{output}: videos cannot be written; write images into a folder (`to=folder`), of "
            "which ffmpeg makes a video"
        )
    if suffix in (".bag", ".db3"):
        raise ConfigError(
            f"{output}: ROS bags cannot be written; give a file ending in .mcap, with "
            "`to=mcap-ros2` for ROS 2"
        )
    is_file = suffix == ".mcap"
    chosen = format or ("mcap" if is_file else "euroc")
    if chosen not in FORMATS:
        raise ConfigError(f"cannot write format '{chosen}'; use one of {', '.join(FORMATS)}")
    if bool(FORMATS[chosen].suffix) != is_file:
        kind = "a file ending in .mcap" if FORMATS[chosen].suffix else "a folder"
        raise ConfigError(f"format {chosen} needs {kind} as output, not {output}")
    return chosen


def size_of(text: str | None) -> tuple[int, int] | float | None:
    """A size or factor of `resize`, None without; raises `ConfigError`."""
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
            f"invalid `resize={text}`; use a size such as 640x400, or a factor such as 0.5"
        )
    return factor
