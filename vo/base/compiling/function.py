"""`@compiled`: functions compiled by numba at their first call and cached as machine code.

Importing numba and loading its own cache takes 0.65 s in every process. llvmlite alone loads the
same machine code in a tenth of that, so numba is imported only if a function must be compiled.
"""

from __future__ import annotations

import gc
import importlib
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar, cast, overload

from vo.base.compiling import machine_code, store
from vo.base.compiling.fingerprint import fingerprint, names_in, source_of
from vo.base.compiling.signatures import describe, signature_of

P = ParamSpec("P")
R = TypeVar("R")

_log = logging.getLogger(__name__)
_compiling = threading.RLock()
_compiled_here: list[str] = []

# Option for functions that only compiled functions call and that neither create nor return arrays.
# By default numba counts references to an array with atomic instructions, for every view and call.
# Here the caller holds the references. Without reference counting a function with views is faster.
NO_REFCOUNT: dict[str, Any] = {"_nrt": False}


class Intrinsic(NamedTuple):
    """Reference to a `numba.extending.intrinsic`; its module is imported only to compile."""

    module: str
    name: str

    def __call__(self, *arguments: Any) -> Any:
        """Refuse calls from Python.

        Raises:
            TypeError: always.
        """
        raise TypeError(f"{self.name} can be called in compiled functions only")

    def fingerprint_of(self) -> tuple[Any, ...]:
        """Everything that its machine code depends on."""
        return self.module, self.name, source_of(self.module)


class Compiled(Generic[P, R]):
    """A function that is compiled once for each signature that it is called with.

    It may call other compiled functions and intrinsics and use constants of its module. It is
    compiled again when one of them changes.

    Args:
        options: of `numba.njit`.
    """

    def __init__(self, function: Callable[P, R], options: dict[str, Any]) -> None:
        self.function = cast("FunctionType", function)
        self.options = {"nogil": True, **options}
        self.__doc__, self.__name__ = function.__doc__, self.function.__name__
        self._entries: dict[tuple[Any, ...], Callable[..., R]] = {}
        self._dispatcher: Any = None
        self._inner_dispatcher: Any = None

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        """Call the machine code; arguments are positional.

        Raises:
            TypeError: an argument is passed by name, or numba does not support its type.
        """
        if named:
            raise TypeError(f"{self.__name__} takes no argument by name")
        signature = signature_of(arguments)
        entry = self._entries.get(signature)
        if entry is None:
            entry = self._find(signature, arguments)
        return entry(*arguments)

    def fingerprint_of(self) -> tuple[Any, ...]:
        """Everything that its machine code depends on."""
        settings = (
            f"{k} {sorted(v) if isinstance(v, set) else v}" for k, v in self.options.items()
        )
        return self.function, *sorted(settings)

    def dispatcher(self) -> Any:
        """The `numba.njit` function that Python calls."""
        with _compiling:
            if self._dispatcher is None:
                self._dispatcher = self._jit(no_cfunc_wrapper=True)
        return self._dispatcher

    def inner_dispatcher(self) -> Any:
        """The `numba.njit` function that compiled functions call, without entries for Python."""
        with _compiling:
            if self._inner_dispatcher is None:
                self._inner_dispatcher = self._jit(no_cfunc_wrapper=True, no_cpython_wrapper=True)
        return self._inner_dispatcher

    def _jit(self, **wrappers: bool) -> Any:
        import numba

        cache = not machine_code.is_supported() and store.is_numba_cache_safe()
        return numba.njit(cache=cache, **(self.options | wrappers))(_for_numba(self.function))

    def _find(self, signature: tuple[Any, ...], arguments: tuple[Any, ...]) -> Callable[..., R]:
        with _compiling:
            if signature not in self._entries:
                self._entries[signature] = self._from_cache(arguments) or self.dispatcher()
            return self._entries[signature]

    def _from_cache(self, arguments: tuple[Any, ...]) -> Callable[..., R] | None:
        """The function from cached machine code, compiled first if it is not cached.

        None if the signature or the installed numba is not supported by the cache.
        """
        types = describe(arguments)
        if types is None or not machine_code.is_supported():
            return None
        name = f"{self.function.__module__}.{self.__name__}"
        path = store.path_of(name, fingerprint(self), types)
        code = store.load(path) or self._compile(path, name, arguments)
        return None if code is None else machine_code.link(code, self.function)

    def _compile(
        self, path: Path, name: str, arguments: tuple[Any, ...]
    ) -> machine_code.MachineCode | None:
        """Machine code for such arguments, from another process that compiles it now, or our own.

        None if it cannot be cached.
        """
        with store.locked(path):
            code = store.load(path)
            if code is None:
                announce_compilation()
                _compiled_here.append(name)
                with _collection_paused():
                    code = machine_code.compile_for(self.dispatcher(), arguments)
                if code is not None:
                    store.save(path, code)
        return code


@overload
def compiled(function: Callable[P, R]) -> Compiled[P, R]: ...


@overload
def compiled(**options: Any) -> Callable[[Callable[P, R]], Compiled[P, R]]: ...


def compiled(function: Any = None, **options: Any) -> Any:
    """Decorate a function to be compiled, optionally with options of `numba.njit`."""
    if function is not None:
        return Compiled(function, {})
    return lambda function: Compiled(function, options)


def compiled_here() -> tuple[str, ...]:
    """Names of the functions that this process compiled instead of loading them."""
    return tuple(_compiled_here)


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Log, once per process, that compilation begins; `vo` prints the line."""
    _log.info("compiling the inner loops, once; this takes about 20 s")


@contextmanager
def _collection_paused() -> Iterator[None]:
    """Pause garbage collection, which takes a seventh of the time of a compilation."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _for_numba(function: FunctionType) -> FunctionType:
    """The function with compiled functions and intrinsics replaced by numba's objects."""
    known = dict(function.__globals__)
    for name in names_in(function.__code__):
        value = known.get(name)
        if isinstance(value, Compiled):
            known[name] = value.inner_dispatcher()
        elif isinstance(value, Intrinsic):
            known[name] = getattr(importlib.import_module(value.module), value.name)
    return FunctionType(
        function.__code__, known, function.__name__, function.__defaults__, function.__closure__
    )
