"""`import vo`: its names, and how little it loads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import vo

PACKAGES = Path(vo.__file__).parent, Path(vo.__file__).parents[1] / "data_synth"


@pytest.mark.parametrize("name", vo.__all__)
def test_a_public_name_can_be_imported(name: str) -> None:
    value = getattr(vo, name)
    if name != "__version__":
        assert value.__doc__, f"vo.{name} has no description"


def test_names_are_listed_and_others_are_refused() -> None:
    assert dir(vo) == sorted(vo.__all__)
    assert not hasattr(vo, "nope")
    with pytest.raises(ImportError):
        from vo import nope  # type: ignore[attr-defined]  # noqa: F401


def loaded_after(code: str) -> set[str]:
    program = f"import sys\n{code}\nprint(*sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return set(result.stdout.split())


def test_importing_the_package_loads_no_library() -> None:
    heavy = {"numpy", "cv2", "numba", "llvmlite", "pydantic", "yaml", "typer", "gtsam", "rerun"}
    assert not loaded_after("import vo") & heavy
    assert not loaded_after("import vo; vo.read_trajectory") & {"typer", "gtsam", "rerun", "numba"}


def test_a_function_of_a_name_is_not_hidden_by_a_module() -> None:
    """`import vo.NAME` must not replace the function `vo.NAME`."""
    code = "import vo.runs.run_recording, vo.api.functions, vo.outputs.evaluation\n"
    names = "assert callable(vo.run) and callable(vo.open) and callable(vo.evaluate)"
    loaded_after(code + names)
    for name in vo.__all__:
        if isinstance(getattr(vo, name), ModuleType):
            continue
        assert not (PACKAGES[0] / f"{name}.py").exists(), name
        assert not (PACKAGES[0] / name).exists(), name


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.name)
def test_type_checkers_are_told_of_annotations(package: Path) -> None:
    assert (package / "py.typed").is_file()
