"""Work that numba repeats for every function, or does for nobody, left out while we compile.

The machine code is the same, byte for byte. Replaces undocumented parts of numba, so that it is
limited to the versions in `machine_code`. Nothing stays replaced: numba's lock is held meanwhile,
so that no other thread compiles with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_call_types: dict[tuple[Any, ...], tuple[Any, Any, Any]] = {}
_installed: set[int] = set()


@contextmanager
def shortcuts() -> Iterator[None]:
    """Use the shortcuts."""
    from numba.core import codegen, cpu, event, ir, lowering
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.targetconfig import ConfigStack
    from numba.core.types.functions import BaseFunction

    typed, install = BaseFunction.get_call_type, cpu.CPUContext.load_additional_registries
    replaced = (
        (BaseFunction, "get_call_type", lambda *given: _call_type(typed, ConfigStack, *given)),
        (cpu.CPUContext, "load_additional_registries", lambda context: _load(install, context)),
        (codegen.CPUCodeLibrary, "_optimize_functions", _optimize_defined),
        (lowering.BaseLower, "create_cfunc_wrapper", _nothing),  # for C, which never calls
        (ir.Inst, "_rec_list_vars", lambda _, value: _variables(ir, value)),
        (event, "start_event", _nothing),  # 150,000 of them, for profilers
        (event, "end_event", _nothing),
    )
    with global_compiler_lock:
        before = [(owner, name, getattr(owner, name)) for owner, name, _ in replaced]
        try:
            for owner, name, value in replaced:
                setattr(owner, name, value)
            yield
        finally:
            for owner, name, value in before:
                setattr(owner, name, value)


def _nothing(*_: Any, **__: Any) -> None:
    pass


def _call_type(typed: Any, flags_of: Any, function: Any, context: Any, *given: Any) -> Any:
    """Signature of a call; nine of ten calls are like one before.

    numba compiles the same numpy function for each set of options of its callers. Here only those
    count that it takes over from them.
    """
    arguments, named = given
    flags = flags_of.top_or_none()
    options = flags and (flags.nrt, str(flags.fastmath), flags.error_model, flags.forceinline)
    key = id(function), id(context), tuple(arguments), tuple(dict(named).items()), options
    if key not in _call_types:
        signature = typed(function, context, arguments, named)
        if signature is None:
            return None
        # The function is kept, so that no other gets its id.
        _call_types[key] = signature, function._impl_keys[signature.args], function
    signature, implementation, _ = _call_types[key]
    function._impl_keys[signature.args] = implementation
    return signature


def _load(install: Any, context: Any) -> None:
    """Load numba's modules once; later only what functions have added."""
    if id(context) in _installed:
        for registry in list(context._registries):
            context.install_registry(registry)
    else:
        install(context)
        _installed.add(id(context))


def _optimize_defined(library: Any, module: Any) -> None:
    """Optimise functions, without those that are only declared."""
    module.data_layout = library._codegen._data_layout
    for function in module.functions:
        if not function.is_declaration:
            manager, builder = library._codegen._function_pass_manager()
            manager.run(function, builder)


def _variables(ir: Any, value: Any) -> list[Any]:
    """Variables in an instruction or its attributes, most of which are texts and places in code."""
    if type(value) is ir.Var:
        return [value]
    if isinstance(value, ir.Inst):
        return list(value.list_vars())
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, list | tuple):
        return []
    parts = (part for part in value if type(part) is not str and type(part) is not ir.Loc)
    return [variable for part in parts for variable in _variables(ir, part)]
