"""The flags of a command, by the names that their options have in Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, fields
from functools import cache
from inspect import Parameter
from typing import Any, get_args, get_origin

from typer.models import OptionInfo

from vo.base.option_names import Flag, with_flags
from vo.cli.blocks import CommandFunction

# Names in Python, and in the command line where they differ.
_IN_PYTHON = {
    "topics": "topic",
    "allow_hosts": "allow_host",
    "allow_origins": "allow_origin",
    "right_offset_ns": "right_offset",
    "timeout_s": "timeout",
    "duration_s": "duration",
    "tolerance_s": "tolerance",
    "interpolated": "interpolate",
    "positions": "scale_from",
    "offset_ns": "scale_offset",
    "height_m": "height",
    "marker_length_m": "markers",
    "marker_map": "markers",
    "lever_arm_m": "lever_arm",
    "length_m": "length",
    "square_m": "square",
    "marker_m": "marker",
    "gap_m": "gap",
    "memory.loops": "loops",
    "memory.map": "map_file",
    "memory.vocabulary": "vocabulary",
    "memory.localize": "localize",
    "masks.files": "mask",
    "masks.ignore": "ignore",
    "masks.roi": "roi",
    "inertial.enabled": "no_imu",
    "memory_mb": "memory",
    "set": "overrides",
}
_commands: list[CommandFunction] = []


def speak_as(command: CommandFunction) -> None:
    """Let messages name the options of this command, besides those of the first that spoke."""
    if command not in _commands[1:]:
        _commands[1:] = [command]
        known_flags.cache_clear()


@cache
def known_flags() -> Mapping[str, Flag]:
    """The flags by the names of options in Python; none outside of a command."""
    own = {
        parameter.name: flag
        for command in _commands
        for parameter in command.__signature__.parameters.values()
        if (flag := _flag(parameter)) is not None
    }
    return own | {name: own[word] for name, word in _IN_PYTHON.items() if word in own}


def given_words(*blocks: Any) -> list[str]:
    """The options in blocks of the command that differ from their defaults, as words of it."""
    return [word for owner in blocks for field in fields(owner) for word in _words(owner, field)]


def _words(owner: Any, field: Field[Any]) -> list[str]:
    value, flag = getattr(owner, field.name), known_flags().get(field.name)
    default = field.default if field.default_factory is MISSING else field.default_factory()
    if flag is None or value == default or value is None:
        return []
    if flag.is_switch:
        return [flag.name if value else flag.negative]
    if isinstance(value, tuple):
        return [flag.name, *map(str, value)]
    values = value if isinstance(value, list) else [value]
    return [word for one in values for word in (flag.name, str(one))]


def in_flags(value: Any) -> Any:
    """Texts, also in lists and dictionaries, with options as flags of the command."""
    if isinstance(value, str):
        return with_flags(value, known_flags()) if "`" in value else value
    if isinstance(value, dict):
        return {key: in_flags(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [in_flags(each) for each in value]
    return value


def _flag(parameter: Parameter) -> Flag | None:
    kind, *extras = get_args(parameter.annotation)
    info = next((each for each in extras if isinstance(each, OptionInfo)), None)
    if info is None:
        return None
    words = [word for word in _declared(info) if word.startswith("--")]
    positive, _, negative = (words or [f"--{parameter.name.replace('_', '-')}"])[0].partition("/")
    parts = (kind, *get_args(kind))
    is_list = any(get_origin(part) is list for part in parts)
    return Flag(positive, negative, bool in parts, is_list)


def _declared(info: OptionInfo) -> Iterable[Any]:
    first = () if info.default is ... or not isinstance(info.default, str) else (info.default,)
    return (*first, *(info.param_decls or ()))
