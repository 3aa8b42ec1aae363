"""What a plain `pip install .` lacks and the developers' environment has: scipy, above all."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
COMPILED = {"compiled", "_compiled", "_entry"}
NEEDS_SCIPY = ("np.linalg.", "np.dot", "np.vdot", "np.roots")


def compiled_functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            names = {ast.unparse(d).partition("(")[0].split(".")[-1] for d in node.decorator_list}
            if names & COMPILED:
                yield node


def uses_of_scipy(source: str) -> list[str]:
    """Expressions that numba compiles into calls of scipy's BLAS and LAPACK."""
    return [
        ast.unparse(node)
        for function in compiled_functions(ast.parse(source))
        for node in ast.walk(function)
        if (isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Call) and ast.unparse(node.func).startswith(NEEDS_SCIPY))
    ]


def test_compiled_functions_do_without_scipy() -> None:
    files = [p for package in ("vo", "data_synth") for p in (ROOT / package).rglob("*.py")]
    found = {str(p.relative_to(ROOT)): uses_of_scipy(p.read_text("utf-8")) for p in files}
    assert {path: uses for path, uses in found.items() if uses} == {}


@pytest.mark.parametrize("expression", ["a @ b", "np.linalg.solve(a, b)", "np.dot(a, b)"])
@pytest.mark.parametrize("decorator", ["compiled(inline='always')", "_compiled"])
def test_a_use_of_scipy_is_found(expression: str, decorator: str) -> None:
    assert uses_of_scipy(f"@{decorator}\ndef f(a, b):\n    return {expression}") == [expression]
