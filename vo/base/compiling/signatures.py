"""Signatures of calls: types of the arguments; of arrays dtype, dimensions and layout."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_ARRAY = np.ndarray
_NUMBERS = {bool: "?", int: "i8", float: "f8"}
_Type = TypeVar("_Type", bound=np.generic)


def usual_array(array: NDArray[_Type]) -> NDArray[_Type]:
    """The array, or a copy that can be written to and is contiguous.

    Views of files and messages are neither, and each layout would be compiled separately.
    """
    return np.require(array, requirements=("C", "W"))


def signature_of(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Key that is equal for arguments of the same types; computed at every call, so kept fast."""
    return tuple(
        [
            (v.dtype, v.ndim, v.flags.num)
            if type(v) is _ARRAY
            else (type(v), signature_of(v))
            if isinstance(v, tuple)
            else type(v)
            for v in values
        ]
    )


def describe(value: Any) -> str | None:
    """Type of a value as text, equal in all processes; None if the type is not supported."""
    if type(value) is _ARRAY:
        return _describe_array(value)
    if isinstance(value, tuple):
        return _describe_tuple(value)
    if isinstance(value, np.generic):
        return value.dtype.str[1:]
    return _NUMBERS.get(type(value))


def _describe_tuple(value: tuple[Any, ...]) -> str | None:
    """Types of the parts; of a named tuple the names too, as code refers to its parts by name."""
    parts = [describe(part) for part in value]
    if None in parts:
        return None
    names = getattr(value, "_fields", None)
    if names is None:
        return f"({' '.join(str(part) for part in parts)})"
    fields = " ".join(f"{name}={part}" for name, part in zip(names, parts, strict=True))
    return f"{type(value).__name__}({fields})"


def _describe_array(array: np.ndarray[Any, Any]) -> str | None:
    flags = array.flags
    if not array.dtype.isnative or array.dtype.kind not in "biuf" or not flags.aligned:
        return None
    layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
    return f"{array.dtype.str[1:]}[{array.ndim}{layout}{'' if flags.writeable else 'r'}]"
