"""Decorators that compile kernels: entry points called by Python, and inlined functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from vo.base.compiling.function import NO_REFCOUNT, compiled

_F = TypeVar("_F", bound=Callable[..., Any])

# Division by zero gives infinity or NaN, as in numpy, without a branch at every division.
_ARITHMETIC = {"error_model": "numpy"}


def entry_point(function: _F) -> _F:
    """Compile a function that Python calls; it releases the GIL, so that threads share the work."""
    return cast(_F, compiled(**_ARITHMETIC)(function))


def inlined(function: _F) -> _F:
    """Compile a function that only kernels call; it can neither make nor return arrays.

    Reference counts of the arrays of `World`, at each call, would take 70 % of the time. Without
    them an array that is returned would be freed too early.
    """
    return cast(_F, compiled(**_ARITHMETIC, forceinline=True, **NO_REFCOUNT)(function))
