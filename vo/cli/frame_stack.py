"""Room for the frames of Python calls.

Python keeps the frames of running functions in chunks of 16 kB. A function that is called in a
loop just where a chunk ends takes a new chunk from the system and gives it back at every call:
3,600 times while modules were loaded, 3 % of the CPU time of a start. Which function that is
changes with every change of the program.

Source: CPython, Python/pystate.c, `push_chunk`: a chunk is 16 kB times the smallest power of two
that holds the frame that it begins with.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType

_SLOTS = 2**15 + 1  # of 8 bytes: more than 256 kB, so that as much is left of a chunk of 512 kB


def with_room(function: Callable[[], None]) -> Callable[[], None]:
    """The same function with a frame so large that all calls below it fit into the same chunk.

    Memory that is not used is not touched.
    """
    if not isinstance(function, FunctionType):
        return function
    code = function.__code__.replace(co_stacksize=_SLOTS)
    return FunctionType(
        code, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
