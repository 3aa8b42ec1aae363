"""The shell scripts of a checkout: installation and its errors."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NEEDED = ("bash", "env", "cat", "cksum", "tr", "dirname", "rm", "touch")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of the files that the set-up needs, and a `bin` without any Python."""
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copy(ROOT / "constraints.txt", tmp_path)
    (tmp_path / "bin").mkdir()
    for name in NEEDED:
        program = shutil.which(name)
        assert program is not None
        (tmp_path / "bin" / name).symlink_to(program)
    return tmp_path


def _call(checkout: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": str(checkout / "bin")}
    return subprocess.run(
        [str(checkout / command[0]), *command[1:]],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )


def _program(path: Path, code: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!{shutil.which('bash')}\n{code}\n")
    path.chmod(0o755)


@pytest.mark.parametrize("script", ["scripts/demo", "scripts/test", "scripts/check"])
def test_a_missing_python_is_reported_in_one_line(checkout: Path, script: str) -> None:
    result = _call(checkout, script)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "no Python 3.11 or newer" in result.stderr


def test_a_python_that_is_too_old_is_ignored(checkout: Path) -> None:
    _program(checkout / "bin" / "python3", "exit 1")
    assert "no Python 3.11 or newer" in _call(checkout, "scripts/setup").stderr


def test_a_missing_venv_module_is_reported_with_the_package_to_install(checkout: Path) -> None:
    code = f'case "$2" in *ensurepip*) exit 1 ;; esac\nexec {sys.executable} "$@"'
    _program(checkout / "bin" / "python3", code)
    result = _call(checkout, "scripts/test")
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "python3-venv" in result.stderr
    assert not (checkout / ".venv").exists()


def _fake_python(checkout: Path, pip_status: int) -> Path:
    """A Python that creates environments and logs the targets of pip, without installing."""
    log = checkout / "pip.log"
    code = (
        'case "$*" in\n'
        f'  "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python"; echo venv >>{log} ;;\n'
        f'  *"pip install"*) echo "${{@: -1}}" >>{log}; exit {pip_status} ;;\n'
        "esac"
    )
    for name in ("mkdir", "cp"):
        (checkout / "bin" / name).symlink_to(str(shutil.which(name)))
    _program(checkout / "bin" / "python3", code)
    return log


def test_installs_once_and_again_when_requirements_change(checkout: Path) -> None:
    log = _fake_python(checkout, pip_status=0)
    for arguments in ((), (), ("dev",), (), ("dev",)):
        assert _call(checkout, "scripts/setup", *arguments).returncode == 0
    assert log.read_text().split() == ["venv", ".[all]", ".[dev]"]
    with (checkout / "pyproject.toml").open("a") as file:
        file.write("\n# changed\n")
    _call(checkout, "scripts/setup")
    assert log.read_text().split() == ["venv", ".[all]", ".[dev]", ".[dev]"]


def test_after_an_interrupted_installation_the_environment_is_new(checkout: Path) -> None:
    log = _fake_python(checkout, pip_status=0)
    _call(checkout, "scripts/setup")
    (checkout / ".venv" / ".installed").unlink()
    (checkout / ".venv" / ".installing").touch()
    assert _call(checkout, "scripts/setup").returncode == 0
    assert log.read_text().split() == ["venv", ".[all]", "venv", ".[all]"]


def test_a_failed_installation_is_repeated(checkout: Path) -> None:
    log = _fake_python(checkout, pip_status=3)
    result = _call(checkout, "scripts/demo")
    assert result.returncode == 1
    assert "the installation failed" in result.stderr
    _call(checkout, "scripts/demo")
    assert log.read_text().split() == ["venv", ".[all]", ".[all]"]


def test_the_files_that_begin_first_exist_once() -> None:
    names = (ROOT / "tests" / "slowest_files.txt").read_text(encoding="utf-8").split()
    found = [path.stem for path in (ROOT / "tests").rglob("test_*.py")]
    assert names and {name: found.count(name) for name in names} == dict.fromkeys(names, 1)
