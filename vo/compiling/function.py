"""Functions that numba compiles when they are first called, and that are kept as machine code.

Importing numba and loading what its own cache holds takes two thirds of a second, in every process
of every run. What it made is machine code, which llvmlite, its library for such things, loads in
a tenth of that. So numba is imported only where something has still to be compiled.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from types import FunctionType
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar, cast, overload

from vo.compiling import machine_code, store
from vo.compiling.fingerprint import fingerprint, names_in, source_of
from vo.compiling.kinds import describe, kinds_of

P = ParamSpec("P")
R = TypeVar("R")

_compiling = threading.RLock()

# For functions that are only called by compiled ones, and neither make nor return an array. Numba
# counts users of an array, up and down by atomic instructions, for every view and every call; here
# the caller holds them.
UNCOUNTED: dict[str, Any] = {"_nrt": False}


class WrittenOut(NamedTuple):
    """A `numba.extending.intrinsic` in a module that is imported when something is compiled."""

    module: str
    name: str

    def __call__(self, *arguments: Any) -> Any:
        """It has no meaning outside.

        Raises:
            TypeError: always.
        """
        raise TypeError(f"{self.name} can be called in compiled functions only")

    def fingerprint_of(self) -> tuple[Any, ...]:
        """What it depends on."""
        return self.module, self.name, source_of(self.module)


class Compiled(Generic[P, R]):
    """A function, compiled for each combination of kinds of arguments that it is called with.

    It calls others of its kind and `WrittenOut` ones, and uses constants of its module, wherever
    they were defined; if one of them changes, it is compiled anew.

    Args:
        function: takes arrays, numbers and tuples of them, and gives such.
        options: for `numba.njit`.
    """

    def __init__(self, function: Callable[P, R], options: dict[str, Any]) -> None:
        self.function = cast("FunctionType", function)
        self.options = {"nogil": True, **options}
        self.__doc__, self.__name__ = function.__doc__, self.function.__name__
        self._entries: dict[tuple[Any, ...], Callable[..., R]] = {}
        self._dispatcher: Any = None

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        """Arguments go by position.

        Raises:
            TypeError: one goes by name, or numba does not know its type.
        """
        if named:
            raise TypeError(f"{self.__name__} takes no argument by name")
        kinds = kinds_of(arguments)
        entry = self._entries.get(kinds)
        if entry is None:
            entry = self._find(kinds, arguments)
        return entry(*arguments)

    def fingerprint_of(self) -> tuple[Any, ...]:
        """What its machine code depends on."""
        settings = (
            f"{k} {sorted(v) if isinstance(v, set) else v}" for k, v in self.options.items()
        )
        return self.function, *sorted(settings)

    def dispatcher(self) -> Any:
        """What numba made, or will make, of the function."""
        with _compiling:
            if self._dispatcher is None:
                import numba

                cache = not machine_code.is_understood()
                compiler = numba.njit(cache=cache, **self.options)
                self._dispatcher = compiler(_for_numba(self.function))
        return self._dispatcher

    def _find(self, kinds: tuple[Any, ...], arguments: tuple[Any, ...]) -> Callable[..., R]:
        with _compiling:
            if kinds not in self._entries:
                self._entries[kinds] = self._kept(arguments) or self.dispatcher()
            return self._entries[kinds]

    def _kept(self, arguments: tuple[Any, ...]) -> Callable[..., R] | None:
        """The function for such arguments, from its machine code, made if need be."""
        types = describe(arguments)
        if types is None or not machine_code.is_understood():
            return None
        name = f"{self.function.__module__}.{self.__name__}"
        place = store.place_of(name, fingerprint(self), types)
        code = store.load(place)
        if code is None:
            code = machine_code.of(self.dispatcher(), arguments)
            if code is None:
                return None
            store.save(place, code)
        return machine_code.callable_of(code, self.function)


@overload
def compiled(function: Callable[P, R]) -> Compiled[P, R]: ...


@overload
def compiled(**options: Any) -> Callable[[Callable[P, R]], Compiled[P, R]]: ...


def compiled(function: Any = None, **options: Any) -> Any:
    """Decorate a function so that it is compiled; with options of `numba.njit`, or without."""
    if function is not None:
        return Compiled(function, {})
    return lambda function: Compiled(function, options)


def _for_numba(function: FunctionType) -> FunctionType:
    """The function, with numba's own things in place of what stands for them here."""
    known = dict(function.__globals__)
    for name in names_in(function.__code__):
        value = known.get(name)
        if isinstance(value, Compiled):
            known[name] = value.dispatcher()
        elif isinstance(value, WrittenOut):
            known[name] = getattr(importlib.import_module(value.module), value.name)
    return FunctionType(
        function.__code__, known, function.__name__, function.__defaults__, function.__closure__
    )
