"""The packages for the index: their description, content, and use from another folder."""

from __future__ import annotations

import email
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import package
import pytest

ROOT = Path(__file__).resolve().parents[1]
REPOSITORY = "https://github.com/visual-odometry/visual-odometry"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel; sdist and wheel have passed `twine check`, and contain the same files."""
    for name in ("hatchling", "hatch_fancy_pypi_readme", "twine"):
        pytest.importorskip(name, reason=f"{name} is not installed; call scripts/setup dev")
    return package.build(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def description(wheel: Path) -> email.message.Message:
    with zipfile.ZipFile(wheel) as archive:
        [name] = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
        return email.message_from_bytes(archive.read(name))


def test_the_description_has_absolute_links_only(description: email.message.Message) -> None:
    text = str(description.get_payload())
    targets = re.findall(r"\]\(([^)]+)\)", text)
    assert len(targets) > 10
    assert [target for target in targets if not target.startswith(("https://", "#"))] == []


def test_links_of_the_description_lead_to_files(description: email.message.Message) -> None:
    raw = REPOSITORY.replace("github.com", "raw.githubusercontent.com")
    tag = f"v{description['Version']}"
    prefixes = (f"{REPOSITORY}/blob/{tag}/", f"{raw}/{tag}/")
    paths = [
        target.removeprefix(prefix).partition("#")[0]
        for target in re.findall(r"\]\((https://[^)]+)\)", str(description.get_payload()))
        for prefix in prefixes
        if target.startswith(prefix)
    ]
    assert len(paths) > 10
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_wheel_has_one_package_with_types_and_presets(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    tops = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert tops == {"vo"}
    assert {"vo/py.typed", "vo/data_synth/py.typed", "vo/configs/default.yaml"} <= names
    assert not any("test" in name.split("/") or name.endswith(".pyc") for name in names)


def test_every_classified_python_is_allowed_and_tried() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    versions = re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    workflow = (ROOT / ".github" / "workflows" / "checks.yml").read_text("utf-8")
    [matrix] = re.findall(r"^ +python: (\[.*\])$", workflow, re.MULTILINE)
    assert versions == re.findall(r'"(3\.\d+)"', matrix)
    assert project["requires-python"] == f">={versions[0]}"


def test_the_repository_has_one_address() -> None:
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md", "mkdocs.yml"):
        addresses = re.findall(r"https://github\.com/[\w-]+/[\w-]+", (ROOT / name).read_text())
        assert set(addresses) == {REPOSITORY}, name


def test_the_wheel_works_from_another_folder(wheel: Path, tmp_path: Path) -> None:
    """Installed without its dependencies, which this environment has, and beside a namesake."""
    (tmp_path / "data_synth.py").write_text("raise ImportError('of another project')")
    target = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-compile"]
    subprocess.run([*install, "--no-index", "--target", str(target), str(wheel)], check=True)
    code = (
        f"import sys; sys.path.insert(0, {str(target)!r})\n"
        "import pkgutil, importlib, vo, vo.cli.app, vo.data_synth\n"
        "for each in pkgutil.walk_packages(vo.data_synth.__path__, 'vo.data_synth.'):\n"
        "    importlib.import_module(each.name)\n"
        "from vo.data_synth.worlds.registry import make_scene\n"
        "from vo.data_synth.writers.registry import FORMATS, load_writer\n"
        "make_scene('room', 0), *map(load_writer, FORMATS)\n"
        "from vo.base.config import load_config\n"
        "load_config('fast')\n"
        "print(vo.__version__, vo.__file__, vo.data_synth.__file__, sep='\\n')"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    version, *files = result.stdout.split()
    assert version == wheel.name.split("-")[1]
    assert all(Path(file).is_relative_to(target) for file in files)


def test_importing_vo_loads_nothing_heavy() -> None:
    command = [sys.executable, "-c", "import sys, vo, data_synth; print(*sys.modules)"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in result.stdout.split()}
    assert not loaded & {"numpy", "cv2", "gtsam", "numba", "llvmlite", "rerun", "av", "matplotlib"}
