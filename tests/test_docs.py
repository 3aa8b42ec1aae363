"""Links, line lengths, and commands of the documentation."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from vo.engine.features.descriptors import DESCRIPTORS
from vo.engine.features.detectors import DETECTORS

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
MAX_WIDTH = 100


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def _lines(page: Path) -> list[tuple[str, bool]]:
    """Each line of a page, and whether it is code."""
    lines, code = [], False
    for line in page.read_text(encoding="utf-8").splitlines():
        fence = line.lstrip().startswith("```")
        code ^= fence
        lines.append((line, code or fence))
    return lines


def _prose(page: Path) -> str:
    """A page without blocks of code."""
    return "\n".join(line for line, code in _lines(page) if not code)


@cache
def _anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub names them."""
    headings = re.findall(r"^#+ (.*)$", _prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_lead_somewhere(page: Path) -> None:
    prose = re.sub(r"`[^`\n]*`", "", _prose(page))
    broken = []
    for link in re.findall(r"\]\(([^()\s]+)\)", prose):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in _anchors(target)):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_prose_is_wrapped(page: Path) -> None:
    long = []
    for line, code in _lines(page):
        if code or line.lstrip().startswith(("|", "![", "<!--")):
            continue
        if len(re.sub(r"\]\([^()\s]+\)", "]", line)) > MAX_WIDTH:
            long.append(line)
    assert long == []


_WINGS = "api|base|cli|engine|outputs|recordings|runs|tools"
_PATH = rf"(?<![\w/.<-])(?:(?:vo|data_synth|scripts|tests|{_WINGS})/[\w/]*(?:/|\w\.py))(?![\w*…])"


@pytest.mark.parametrize("page", [p for p in PAGES if p.name != "CHANGELOG.md"], ids=_name)
def test_modules_that_are_named_exist(page: Path) -> None:
    """Paths of the repository or of the package; capitals are what a reader chooses."""
    text = "\n".join(
        line for line in page.read_text("utf-8").splitlines() if "vo batch" not in line
    )
    named = {path for path in re.findall(_PATH, text) if not re.search("[A-Z]{2}", path)}
    assert [path for path in sorted(named) if not _is_a_place(path)] == []


def _is_a_place(path: str) -> bool:
    return (ROOT / path).exists() or (ROOT / "vo" / path).exists()


@cache
def _options() -> dict[str, set[str]]:
    """Options of each command of `vo`."""
    from vo.cli.app import app

    commands: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    return {
        name: {"--help", "-h"} | {word for parameter in command.params for word in parameter.opts}
        for name, command in commands.items()
    }


def _calls(page: Path) -> list[tuple[str, str]]:
    """Calls of `vo` on a page, in code or between backquotes: the command and its arguments."""
    text = "\n".join(f"`{line}`" if code else line for line, code in _lines(page))
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"(\S)\n(?=\S)", r"\1 ", text))
    pattern = r"(?:^|[\s/])vo ([a-z]+)(?=\s|$)([^#|&;]*)"
    return [call for span in spans for call in re.findall(pattern, span)]


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_commands_and_their_options_exist(page: Path) -> None:
    wrong = []
    for command, arguments in _calls(page):
        known = _options().get(command)
        options = re.findall(r"(?:^|\s)(--[a-z][a-z-]*|-[a-z])(?=[\s=]|$)", arguments)
        if known is None or not known.issuperset(options):
            wrong.append(f"vo {command} {' '.join(options)}")
    assert wrong == []


def test_calls_are_found_in_prose_and_code(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("Use `vo run x --mode\nmono`.\n\n```sh\n.venv/bin/vo view out # look\n```\n")
    assert _calls(page) == [("run", " x --mode mono"), ("view", " out ")]


def test_the_page_names_every_detector_and_descriptor() -> None:
    page = (ROOT / "docs" / "features.md").read_text(encoding="utf-8")
    assert [name for name in (*DETECTORS, *DESCRIPTORS) if f"`{name}`" not in page] == []
