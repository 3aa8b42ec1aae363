"""Values that the shell completes: formats, presets and topics of the recording on the line."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import typer

INPUT_FORMATS = (
    *("mcap", "rosbag1", "rosbag2", "kitti", "kitti_raw", "4seasons", "euroc", "tum"),
    *("tartanair", "nerf", "nuscenes", "video", "glob", "folder", "stray"),
)
"""Formats of `--format`."""

OUTPUT_FORMATS = ("euroc", "kitti", "tum", "folder", "mcap", "mcap-ros2")
"""Formats of `--to`."""

CODECS = ("png", "jpeg", "raw")
"""Image codecs of recordings that are written."""


def input_formats() -> list[str]:
    """Formats of a recording."""
    return list(INPUT_FORMATS)


def output_formats() -> list[str]:
    """Formats in which a recording is written."""
    return list(OUTPUT_FORMATS)


def codecs() -> list[str]:
    """Image codecs of recordings that are written."""
    return list(CODECS)


def presets() -> list[str]:
    """Presets of the odometry."""
    from vo.base.settings import names_in, preset_folder

    return names_in(preset_folder())


def detectors() -> list[str]:
    """Detectors of features."""
    from typing import get_args

    from vo.base.config import DetectorName

    return list(get_args(DetectorName))


def descriptors() -> list[str]:
    """Descriptors of features."""
    from typing import get_args

    from vo.base.config import DescriptorName

    return list(get_args(DescriptorName))


def recipes() -> list[str]:
    """Presets of synthetic recordings."""
    from vo.base.settings import names_in, preset_folder

    return names_in(preset_folder() / "synth")


def cameras() -> list[str]:
    """Cameras of synthetic recordings."""
    from vo.base.settings import names_in, preset_folder

    return names_in(preset_folder() / "synth" / "cameras")


def image_topics(ctx: typer.Context) -> list[str]:
    """Image topics of the log on the line; none if it cannot be read, or is not a file."""
    from vo.base.errors import VoError
    from vo.recordings.sources.registry import open_container

    words = [ctx.params.get("source"), *ctx.args]  # the latter while an option has no value yet
    paths = [Path(str(word)) for word in words if str(word).endswith(".mcap")]
    path = next(filter(Path.is_file, paths), None)
    if path is None:  # bags are read from one end to the other, which takes too long
        return []
    with suppress(VoError, OSError):
        from vo.recordings.sources.logs.choice import IMAGE_KINDS

        log = open_container(path, "mcap")
        return [topic.name for topic in log.topics if issubclass(topic.codec.kind, IMAGE_KINDS)]
    return []
