"""Files that people and services expect of a project: valid, and in agreement with each other."""

from __future__ import annotations

import datetime
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

import vo

ROOT = Path(__file__).resolve().parents[1]
CITATION_KEYS = {"authors", "cff-version", "message", "title"}
"""Required by the schema of the Citation File Format 1.2.0."""

CITATION_TYPES = {"software", "dataset"}


def _yaml(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text("utf-8"))


def test_the_citation_is_valid_and_of_this_version() -> None:
    citation = _yaml("CITATION.cff")
    assert citation.keys() >= CITATION_KEYS
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] in CITATION_TYPES
    assert citation["license"] == "Apache-2.0"
    assert citation["authors"] and all("name" in author for author in citation["authors"])
    assert str(citation["version"]) == vo.__version__
    assert datetime.date.fromisoformat(citation["date-released"])


def test_every_release_of_the_changelog_has_a_link() -> None:
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    releases = re.findall(r"^## \[([^]]+)\]", text, re.MULTILINE)
    links = re.findall(r"^\[([^]]+)\]: https://", text, re.MULTILINE)
    assert releases[0] == "Unreleased"
    assert links == releases
    assert releases[1] == vo.__version__


def test_the_workflow_calls_scripts_that_exist() -> None:
    workflow = _yaml(".github/workflows/checks.yml")
    commands = [
        step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step
    ]
    scripts = [command.split()[0] for command in commands if command.startswith("scripts/")]
    assert {"scripts/check", "scripts/test", "scripts/package", "scripts/docs"} <= set(scripts)
    for script in scripts:
        assert (ROOT / script).stat().st_mode & 0o111, script


def test_contributing_names_scripts_that_exist() -> None:
    for name in ("CONTRIBUTING.md", "README.md"):
        text = (ROOT / name).read_text("utf-8")
        for script in re.findall(r"scripts/(\w+)", text):
            assert (ROOT / "scripts" / script).is_file(), f"{name}: scripts/{script}"


def test_the_image_is_built_from_files_that_exist_and_are_sent() -> None:
    """The image itself is built in CI only, as that needs docker."""
    lines = (ROOT / "Dockerfile").read_text("utf-8").replace("\\\n", " ").splitlines()
    sent = {
        line[1:] for line in (ROOT / ".dockerignore").read_text().split() if line.startswith("!")
    }
    copied = {
        source
        for line in lines
        if line.startswith("COPY ") and "--from" not in line
        for source in line.split()[1:-1]
    }
    assert copied == sent
    assert all((ROOT / source).exists() for source in copied)
    assert any(line.startswith("RUN ") and "vo warmup" in line for line in lines)
    assert 'ENTRYPOINT ["vo"]' in lines


def test_commands_of_the_image_work(tmp_path: Path) -> None:
    """pip is given what the first stage copies; it finds the version and the description."""
    from hatchling.build import prepare_metadata_for_build_wheel

    for line in (ROOT / "Dockerfile").read_text("utf-8").splitlines():
        if line.startswith("COPY ") and "--from" not in line:
            for source in line.split()[1:-1]:
                path = ROOT / source
                if path.is_dir():
                    shutil.copytree(path, tmp_path / source)
                else:
                    shutil.copy(path, tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        name = prepare_metadata_for_build_wheel(str(tmp_path))
    assert name == f"visual_odometry-{vo.__version__}.dist-info"
