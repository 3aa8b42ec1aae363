"""Machine code is the same with and without the shortcuts, and numba is left as it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vo.base.compiling import machine_code
from vo.base.compiling.shortcuts import shortcuts

numba = pytest.importorskip("numba")
pytestmark = pytest.mark.skipif(not machine_code.is_supported(), reason="for numba 0.68")
_SIGNATURE = (numba.float64[:, ::1], numba.int64)


def _kernel(values: Any, count: int) -> Any:
    sums = np.zeros((count, 3))
    for row in range(values.shape[0]):
        for column in range(3):
            value = max(values[row, column], 0.5)
            sums[row % count, column] += value * value
    return sums


def _code(**options: Any) -> tuple[bytes, ...]:
    """Instructions of the kernel, compiled anew."""
    from llvmlite import binding

    dispatcher = numba.njit(no_cfunc_wrapper=True, **options)(_kernel)
    dispatcher.compile(_SIGNATURE)
    library = dispatcher.overloads[_SIGNATURE]._asdict()["library"]
    file = binding.ObjectFileRef.from_data(library.serialize_using_object_code()[2][0])
    return tuple(part.data() for part in file.sections() if part.is_text())


@pytest.fixture
def libraries(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the functions that numba compiles."""
    from numba.core.codegen import CPUCodegen

    names: list[str] = []
    create = CPUCodegen.create_library

    def listed(codegen: Any, name: str, **options: Any) -> Any:
        names.append(name)
        return create(codegen, name, **options)

    monkeypatch.setattr(CPUCodegen, "create_library", listed)
    return names


def test_machine_code_is_the_same() -> None:
    without = _code()
    with shortcuts():
        assert _code() == without
        fused = _code(fastmath={"contract", "reassoc"})
    assert fused == _code(fastmath={"contract", "reassoc"})
    assert fused != without


def test_functions_of_numpy_are_compiled_once_for_callers_with_any_wrappers(
    libraries: list[str],
) -> None:
    with shortcuts():
        _code(nogil=True)
        libraries.clear()
        _code(nogil=True, no_cpython_wrapper=True)
    assert libraries == ["_kernel"]


def test_numba_is_left_as_it_was_after_an_error() -> None:
    from numba.core import codegen, cpu, event, ir, lowering
    from numba.core.types.functions import BaseFunction

    owners = (BaseFunction, cpu.CPUContext, codegen.CPUCodeLibrary, lowering.BaseLower, ir.Inst)
    before = [dict(vars(owner)) for owner in (*owners, event)]
    with pytest.raises(ValueError, match="wrong"), shortcuts():
        assert dict(vars(event)) != before[-1]
        raise ValueError("wrong")
    assert [dict(vars(owner)) for owner in (*owners, event)] == before
