"""What a function does, as one number: it changes if its machine code may have to.

Comments, names of files and numbers of lines do not count. What it calls counts, in whichever
module that is, and so do the constants that it uses; numba's own cache only looks at the date of
the file that a function is in.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


def fingerprint(value: Any) -> str:
    """A hash of a function, and of all that it refers to.

    Raises:
        TypeError: it refers to something of which nobody knows whether it stays the same.
    """
    return hashlib.sha256("\n".join(_parts(value, set())).encode()).hexdigest()


def names_in(code: CodeType) -> set[str]:
    """Names that code, with functions inside it, looks up in its module or in something else."""
    inside = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*(names_in(c) for c in inside))


def _parts(value: Any, seen: set[int]) -> Iterator[str]:
    if hasattr(value, "fingerprint_of"):
        yield from _parts(value.fingerprint_of(), seen)
    elif isinstance(value, FunctionType):
        yield from _parts_of_function(value, seen)
    elif isinstance(value, CodeType):
        yield value.co_code.hex()
        yield f"{value.co_names} {value.co_varnames} {value.co_argcount}"
        yield from _parts(value.co_consts, seen)
    elif isinstance(value, tuple | frozenset):
        yield f"{type(value).__name__} of {len(value)}"
        for part in value if isinstance(value, tuple) else sorted(value, key=repr):
            yield from _parts(part, seen)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.str} {value.shape} {value.tobytes().hex()}"
    elif isinstance(value, ModuleType | type | BuiltinFunctionType | np.ufunc):
        yield f"{value.__name__} {getattr(value, '_fields', '')}"  # of a named tuple
    elif value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        yield f"{type(value).__name__} {value!r}"
    else:
        raise TypeError(f"compiled code refers to a {type(value).__name__}")


def _parts_of_function(function: FunctionType, seen: set[int]) -> Iterator[str]:
    if id(function) in seen:
        return
    seen.add(id(function))
    yield function.__name__
    yield from _parts(function.__code__, seen)
    yield from _parts(function.__defaults__, seen)
    for cell in function.__closure__ or ():
        yield from _parts(cell.cell_contents, seen)
    for name in sorted(names_in(function.__code__)):
        if name in function.__globals__:
            yield name
            yield from _parts(function.__globals__[name], seen)


def source_of(module: str) -> bytes:
    """A module's source, without importing it."""
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_bytes()
