"""Hash of a function, which changes whenever its machine code could change.

It includes the bytecode of the function and of all functions that it calls, in any module, and the
values of constants; not comments, file names and line numbers. numba's own cache compares only the
date of the file that contains the function.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType, NoneType
from typing import Any

import numpy as np

_PLAIN = frozenset({NoneType, bool, int, float, str, bytes})


def fingerprint(value: Any) -> str:
    """Hash of a function and of everything that it refers to.

    Raises:
        TypeError: it refers to an object that may change without notice, such as a list.
    """
    return hashlib.sha256("\n".join(_parts(value, set())).encode()).hexdigest()


def names_in(code: CodeType) -> set[str]:
    """Names of globals and attributes in code, including functions inside it."""
    inside = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*(names_in(c) for c in inside))


def _parts(value: Any, seen: set[int]) -> Iterator[str]:
    if type(value) in _PLAIN:  # most values
        yield f"{type(value).__name__} {value!r}"
    elif hasattr(value, "fingerprint_of"):
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
    elif isinstance(value, int | float | str | bytes | np.generic):
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
    """Source of a module, which is not imported."""
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_bytes()
