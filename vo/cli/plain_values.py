"""Values of options that are obvious, so that Typer need not load pydantic for them.

Typer reads every value of an option through pydantic, which takes 60 ms of a start, even where no
option is given. Values that are not obvious, or wrong, are left to it, with its messages.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import Any

_INTEGER = re.compile("-?[0-9]{1,9}")


def read_plainly(parameters: Sequence[Any]) -> Sequence[Any]:
    """The parameters of Typer, which read obvious values without pydantic, if it uses that."""
    for each in parameters:
        if hasattr(each, "_runtime_param") and hasattr(each, "type_descriptor"):
            each._runtime_param = _PlainValues()
    return parameters


class _PlainValues:
    """In place of Typer's `RuntimeParam`, which is made when it is needed."""

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value of the type that the command declares."""
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        kind, about = param.type_descriptor.annotation, param.type_descriptor.parameter_info
        plain = _plain(value, kind, about) if about.parser is None else None
        if plain is not None:
            return plain
        param._runtime_param = None
        return param.get_runtime_param().coerce(value, param=param, ctx=ctx)


def _plain(value: Any, kind: Any, about: Any) -> Any:
    """The value, or None if it is not obvious."""
    if kind == list[str] and all(isinstance(each, str) for each in value):
        return list(value)
    if not isinstance(kind, type):
        return None
    if type(value) is kind:  # a default, or a text
        return value
    if not isinstance(value, str):
        return None
    if issubclass(kind, Enum):
        return next((choice for choice in kind if choice.value == value), None)
    if kind is int and _INTEGER.fullmatch(value):
        number = int(value)
        low, high = (number if each is None else each for each in (about.min, about.max))
        return number if low <= number <= high else None
    return Path(value) if kind is Path and _is_any_path(value, about) else None


def _is_any_path(value: str, about: Any) -> bool:
    """Whether a path is nothing that Typer would refuse or replace."""
    checks = (about.exists, about.writable, about.resolve_path, about.path_type)
    is_free = about.file_okay and about.dir_okay and not any(checks)
    return is_free and (os.access(value, os.R_OK) or not os.path.exists(value))
