"""Layouts of recordings, by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import NamedTuple, cast

from data_synth.recipe import Recipe
from data_synth.records import Write
from data_synth.writers.limits import check_kitti, check_mcap, check_nothing, check_ros2, check_tum
from vo.base.errors import ConfigError
from vo.base.types import Rig


class Format(NamedTuple):
    """Writer and limits of a layout."""

    write: str  # `module:function` of a `Write`, imported on demand
    codecs: tuple[str, ...]
    suffix: str = ""  # of the file; empty for folders
    # given the cameras and whether frames are dropped, raises if they do not fit
    check: Callable[[Rig, bool], None] = check_nothing


_IN_FILES = ("png", "jpeg")
_IN_MESSAGES = ("png", "jpeg", "raw")

FORMATS: dict[str, Format] = {
    "euroc": Format("data_synth.writers.euroc:write", _IN_FILES),
    "kitti": Format("data_synth.writers.kitti:write", _IN_FILES, check=check_kitti),
    "tum": Format("data_synth.writers.tum:write", _IN_FILES, check=check_tum),
    "folder": Format("data_synth.writers.folder:write", _IN_FILES),
    "mcap": Format("data_synth.writers.mcap:write_foxglove", _IN_MESSAGES, ".mcap", check_mcap),
    "mcap-ros2": Format("data_synth.writers.mcap:write_ros2", _IN_MESSAGES, ".mcap", check_ros2),
}


def load_writer(name: str) -> Write:
    """The writer of a layout, one of `FORMATS`."""
    module, _, function = FORMATS[name].write.partition(":")
    return cast(Write, getattr(importlib.import_module(module), function))


def check(recipe: Recipe, rig: Rig) -> None:
    """Check, before rendering, that a layout can represent the recording of a recipe.

    Raises:
        ConfigError: the layout cannot represent it.
        CalibrationError: the layout requires a rectification, and the pair has none.
    """
    format = FORMATS[recipe.format]
    if recipe.codec not in format.codecs:
        raise ConfigError(
            f"format {recipe.format} does not support codec {recipe.codec}; choose "
            f"{' or '.join(format.codecs)}, or format mcap"
        )
    format.check(rig, recipe.effects.drops > 0.0)
