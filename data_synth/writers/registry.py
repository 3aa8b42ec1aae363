"""The layouts that recordings are written in, by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import NamedTuple, cast

from data_synth.recipe import Recipe
from data_synth.records import Write
from data_synth.writers.limits import check_kitti, check_mcap, check_nothing, check_tum
from vo.errors import ConfigError
from vo.types import Rig


class Format(NamedTuple):
    """How a layout is written and what it can hold.

    Attributes:
        write: `module:function` of a `Write`, imported when it is needed.
        codecs: of the images.
        suffix: of the file; empty if it is a folder.
        check: given the cameras and whether frames are dropped, refuses what it cannot hold.
    """

    write: str
    codecs: tuple[str, ...]
    suffix: str = ""
    check: Callable[[Rig, bool], None] = check_nothing


_IN_FILES = ("png", "jpeg")
_IN_MESSAGES = ("png", "jpeg", "raw")

FORMATS: dict[str, Format] = {
    "euroc": Format("data_synth.writers.euroc:write", _IN_FILES),
    "kitti": Format("data_synth.writers.kitti:write", _IN_FILES, check=check_kitti),
    "tum": Format("data_synth.writers.tum:write", _IN_FILES, check=check_tum),
    "folder": Format("data_synth.writers.folder:write", _IN_FILES),
    "mcap": Format("data_synth.writers.mcap:write_foxglove", _IN_MESSAGES, ".mcap", check_mcap),
    "mcap-ros2": Format("data_synth.writers.mcap:write_ros2", _IN_MESSAGES, ".mcap", check_mcap),
}


def load_writer(name: str) -> Write:
    """The writer of a layout, one of `FORMATS`."""
    module, _, function = FORMATS[name].write.partition(":")
    return cast(Write, getattr(importlib.import_module(module), function))


def check(recipe: Recipe, rig: Rig) -> None:
    """Refuse what the layout of a recipe cannot hold, before anything is rendered.

    Args:
        recipe: the settings.
        rig: the cameras that they lead to.

    Raises:
        ConfigError: saying what to change.
        CalibrationError: a pair cannot be rectified, and the layout says how to.
    """
    format = FORMATS[recipe.format]
    if recipe.codec not in format.codecs:
        raise ConfigError(
            f"format {recipe.format} cannot hold images as {recipe.codec}; choose codec "
            f"{' or '.join(format.codecs)}, or format mcap"
        )
    format.check(rig, recipe.effects.drops > 0.0)
