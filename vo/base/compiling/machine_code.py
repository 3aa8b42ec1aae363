"""Extraction of machine code from numba, and linking of machine code without numba.

numba's own cache works in the same way: llvmlite links an object file, and the entry for Python in
it becomes a function. Only the import of numba is saved. Undocumented parts of numba are used, so
this is limited to versions and systems on which the tests pass; elsewhere numba's cache is used.
"""

from __future__ import annotations

import builtins
import ctypes
import importlib
import importlib.util
import os
import pickle
import platform
import sys
from collections.abc import Callable
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

_SUPPORTED_VERSIONS = ("0.68.",)
_SUPPORTED_SYSTEM = ("CPython", "Linux", "x86_64")
# Symbols of Intel's mathematics library, which numba uses if installed; it is not loaded here.
_FOREIGN = b"__svml_"

_unpickled: dict[int, Any] = {}  # by the address of its bytes


class MachineCode(NamedTuple):
    """Machine code of one function for one signature.

    Attributes:
        object_file: in the format of the system's linker.
        environment: symbol of the pointer to Python objects that the code uses.
    """

    object_file: bytes
    entry: str
    environment: str
    constants: list[Any]


@lru_cache(maxsize=1)
def is_supported() -> bool:
    """Whether this module supports the installed numba on this system."""
    system = (platform.python_implementation(), platform.system(), platform.machine())
    return system == _SUPPORTED_SYSTEM and _numba_version().startswith(_SUPPORTED_VERSIONS)


@lru_cache(maxsize=1)
def toolchain() -> str:
    """Versions of the compiler and of Python, and the processor that code is compiled for."""
    import llvmlite
    from llvmlite import binding

    processor = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    versions = (_numba_version(), llvmlite.__version__, sys.implementation.cache_tag)
    return " ".join((*versions, processor, features))


def compile_for(dispatcher: Any, arguments: tuple[Any, ...]) -> MachineCode | None:
    """Compile a `numba.njit` function for the types of arguments; None if it cannot be cached."""
    import numba

    signature = tuple(map(numba.typeof, arguments))
    dispatcher.compile(signature)
    compiled = dispatcher.overloads[signature]
    object_file = compiled.library.serialize_using_object_code()[2][0]
    if _FOREIGN in object_file or compiled.referenced_envs:
        return None
    return MachineCode(
        object_file,
        compiled.fndesc.llvm_cpython_wrapper_name,
        compiled.target_context.get_env_name(compiled.fndesc),
        list(compiled.environment.consts),
    )


def link(code: MachineCode, function: FunctionType) -> Callable[..., Any]:
    """Link machine code and return a function that executes it.

    The caller checks the types of arguments: the function itself hardly does.
    """
    from llvmlite import binding

    functions, engine = _extension("_dynfunc"), _engine()
    engine.add_object_file(binding.ObjectFileRef.from_data(code.object_file))
    engine.finalize_object()
    environment = functions.Environment({})
    environment.consts.extend(code.constants)
    pointer = ctypes.c_void_p.from_address(engine.get_global_value_address(code.environment))
    pointer.value = id(environment)
    entry = engine.get_function_address(code.entry)
    module = sys.modules[function.__module__]
    # The function holds references to the environment and to the last argument.
    made: Callable[..., Any] = functions.make_function(
        module, function.__name__, function.__doc__ or "", entry, environment, (engine,)
    )
    return made


@lru_cache(maxsize=1)
def _engine() -> Any:
    """The linker, with all symbols that numba's machine code refers to."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    binding.add_symbol("_Py_NoneStruct", id(None))
    for kind in vars(builtins).values():
        if isinstance(kind, type) and issubclass(kind, BaseException):
            binding.add_symbol(f"PyExc_{kind.__name__}", id(kind))
    for name in ("_helperlib", "_dynfunc"):
        for symbol, address in _extension(name).c_helpers.items():
            binding.add_symbol(f"numba_{symbol}", address)
    if "numba" not in sys.modules:
        binding.add_symbol("numba_unpickle", ctypes.cast(_UNPICKLE, ctypes.c_void_p).value)
    memory = _extension("core/runtime/_nrt_python")
    for symbol, address in memory.c_helpers.items():
        binding.add_symbol(symbol if symbol.startswith("_") else f"NRT_{symbol}", address)
    memory.memsys_use_cpython_allocator()
    triple = binding.get_process_triple()
    machine = binding.Target.from_triple(triple).create_target_machine(
        cpu=binding.get_host_cpu_name(), reloc="static", codemodel="jitdefault", jit=True
    )
    nothing = binding.parse_assembly(f'target triple = "{triple}"')
    return binding.create_mcjit_compiler(nothing, machine)


def _unpickle(address: int, length: int, digest: int) -> Any:
    """Python object that machine code contains; numba's own function would import numba."""
    if address not in _unpickled:
        _unpickled[address] = pickle.loads(ctypes.string_at(address, length))
    return _unpickled[address]


_UNPICKLE = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(
    _unpickle
)


@lru_cache(maxsize=3)
def _extension(name: str) -> ModuleType:
    """One of numba's extension modules, imported without the package."""
    dotted = "numba." + name.replace("/", ".")
    if "numba" in sys.modules:
        return importlib.import_module(dotted)
    base = _numba_folder() / name
    path = next(p for s in EXTENSION_SUFFIXES if (p := base.with_name(base.name + s)).exists())
    loader = ExtensionFileLoader(dotted, str(path))
    spec = importlib.util.spec_from_loader(dotted, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


@lru_cache(maxsize=1)
def _numba_version() -> str:
    """Read without importing numba; empty if it cannot be found."""
    spec = importlib.util.spec_from_file_location("", _numba_folder() / "_version.py")
    assert spec is not None and spec.loader is not None
    version = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(version)
        return str(version.get_versions()["version"])
    except (OSError, AttributeError, KeyError):
        return ""


@lru_cache(maxsize=1)
def _numba_folder() -> Path:
    spec = importlib.util.find_spec("numba")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent
