"""How kernels are compiled: entry points that Python calls, and functions inlined into them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from vo.compiling.function import UNCOUNTED, compiled

_F = TypeVar("_F", bound=Callable[..., Any])

# Division by zero gives infinity or NaN, as in numpy, without a branch at every division.
_ARITHMETIC = {"error_model": "numpy"}
# No wrappers for Python and C: without them, compiling takes half the time.
_INTERNAL = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def entry_point(function: _F) -> _F:
    """Compile a function that Python calls; it releases the GIL, so that threads share the work."""
    return cast(_F, compiled(**_ARITHMETIC)(function))


def inlined(function: _F) -> _F:
    """Compile a function that only kernels call; it can neither make nor return arrays.

    Reference counts of the arrays of `World`, at each call, would take 70 % of the time. Without
    them an array that is returned would be freed too early.
    """
    return cast(_F, compiled(**_ARITHMETIC, **_INTERNAL, **UNCOUNTED)(function))
