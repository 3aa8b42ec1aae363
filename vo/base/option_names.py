"""Options in messages: written as Python has them, and as the flags of a command where it prints.

A message writes an option in backticks, with its value if it has one: `mode=mono`, `calibration`,
`memory.loops=false`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

_OPTION = re.compile(r"`([a-z_][a-z0-9_]*(?:\.[a-z0-9_]+)?)(?:=([^`]*))?`")


class Flag(NamedTuple):
    """How a command line gives an option.

    Attributes:
        name: `--mode`, or `--loops` of a switch.
        negative: `--no-loops`, empty without one.
        is_switch: whether it has no value.
        is_list: whether it is repeated for each value.
    """

    name: str
    negative: str = ""
    is_switch: bool = False
    is_list: bool = False


def with_flags(text: str, flags: Mapping[str, Flag]) -> str:
    """A message in which the options of a command appear as its flags; others stay."""
    if not flags or "`" not in text:
        return text
    return _OPTION.sub(lambda found: _flagged(found, flags), text)


def _flagged(found: re.Match[str], flags: Mapping[str, Flag]) -> str:
    name, value = found[1], found[2]
    flag = flags.get(name)
    if flag is None:
        is_setting = "." in name and value is not None and "set" in flags
        return f"{flags['set'].name} {name}={value}" if is_setting else found[0]
    if value is None:
        return flag.name
    if flag.is_switch:
        return flag.negative or flag.name if value.lower() == "false" else flag.name
    values = value.split() if flag.is_list else [value]
    return " ".join(f"{flag.name} {each}" for each in values)
