"""Dependencies: all that is imported is declared, and versions and licences are listed."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from constraints import constraints
from dependencies import CAMERAS, EXTRAS_OF_MODULES, direct, missing, required
from licences import EXTRAS, PATH, rows
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
OWN = {"vo", "data_synth"}

needs_all = pytest.mark.skipif(
    missing() is not None, reason=f"{missing()} is not installed; call scripts/setup dev"
)


def imported_packages() -> Iterator[tuple[str, str]]:
    """Top-level packages of others that are imported anywhere, with the file."""
    for path in (p for name in sorted(OWN) for p in sorted((ROOT / name).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                continue
            for name in {each.split(".")[0] for each in names}:
                if name not in OWN and name not in sys.stdlib_module_names:
                    yield name, str(path.relative_to(ROOT))


@needs_all
def test_all_that_is_imported_is_declared() -> None:
    declared = set().union(*(direct(extra) for extra in ("", *EXTRAS, *CAMERAS)))
    owners = packages_distributions()
    undeclared = {
        (package, path)
        for package, path in imported_packages()
        if package not in EXTRAS_OF_MODULES
        and not declared & {canonicalize_name(owner) for owner in owners.get(package, [])}
    }
    assert undeclared == set()


@needs_all
def test_constraints_cover_all_dependencies_in_the_versions_tested_here() -> None:
    listed = constraints()
    installed = required(("dev",))
    assert {name: listed.get(name) for name in installed} == installed


def test_constraints_are_versions_only() -> None:
    assert len(constraints()) > 100
    for name, version in constraints().items():
        assert name == canonicalize_name(name)
        assert version[0].isdigit() and not set(version) & set(" ;@/")


@needs_all
def test_the_page_of_licences_is_current() -> None:
    lines = PATH.read_text("utf-8").splitlines()
    assert [str(row) for row in rows().values() if str(row) not in lines] == []
    listed = {line.split("]")[0].removeprefix("- [") for line in lines if line.startswith("- [")}
    others = listed - rows().keys()  # needed by other versions of Python only
    assert others <= {"backports-zstd", "typing-extensions", "tzdata"}


@needs_all
def test_no_dependency_of_a_user_is_under_the_gpl() -> None:
    for row in rows().values():
        assert "GPL" not in row.licence.replace("LGPL", ""), row
