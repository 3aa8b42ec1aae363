"""The page in a real browser."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from vo.cli.app import app

playwright = pytest.importorskip("playwright.sync_api")

_INVISIBLE = """() => [...document.querySelectorAll('svg')].filter(svg => {
    const box = svg.getBoundingClientRect();
    return box.width < 300 || box.height < 100 || svg.querySelectorAll('path').length < 5;
}).length"""
_NUMBERS = """() => Object.fromEntries([...document.querySelectorAll('.cards div')].map(
    card => [card.querySelector('dt').innerText, card.querySelector('dd').innerText]))"""
_LUMINANCE = """() => ['body', 'h2'].map(name => {
    const style = getComputedStyle(document.querySelector(name));
    const rgb = (name == 'body' ? style.backgroundColor : style.color).match(/[0-9]+/g);
    return Math.max(...rgb.map(Number));
})"""
_AXIS_TEXT = "() => getComputedStyle(document.querySelector('svg text')).fill"


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def report(report_runs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("browser") / "a report.html"
    result = CliRunner().invoke(app, ["report", str(report_runs[0]), "-o", str(path)])
    assert result.exit_code == 0, result.output
    return path


def open_page(browser: Any, path: Path, **options: Any) -> tuple[Any, list[str]]:
    """The page, its errors, and its requests for other files."""
    page = browser.new_page(**options)
    seen: list[str] = []
    page.on("console", lambda message: seen.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: seen.append(f"error: {error}"))
    page.on("request", lambda request: seen.append(f"request: {request.url[:60]}"))
    page.goto(path.as_uri())
    page.wait_for_load_state("networkidle")
    return page, [each for each in seen if "request: data:" not in each]


def test_the_page_opens_without_requests_and_shows_the_numbers(
    browser: Any, report: Path, report_runs: list[Path]
) -> None:
    page, seen = open_page(browser, report)
    assert seen == [f"request: {report.as_uri()[:60]}"]
    numbers = page.evaluate(_NUMBERS)
    summary = json.loads((report_runs[0] / "summary.json").read_text(encoding="utf-8"))
    assert numbers["keyframes"] == str(summary["keyframes"])
    assert numbers["frames with a pose"] == "100 %"
    assert float(numbers["inliers"]) == summary["median_inliers"]
    assert page.evaluate(_INVISIBLE) == 0
    assert page.evaluate("document.images.length") >= 2
    assert page.evaluate("[...document.images].every(image => image.naturalWidth > 50)")
    page.close()


def test_the_page_fits_a_phone(browser: Any, report: Path) -> None:
    page, _ = open_page(browser, report, viewport={"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.close()


@pytest.mark.parametrize(("scheme", "is_dark"), [("light", False), ("dark", True)])
def test_the_page_is_legible_in_light_and_dark_mode(
    browser: Any, report: Path, scheme: str, is_dark: bool
) -> None:
    page, _ = open_page(browser, report, color_scheme=scheme)
    paper, ink = page.evaluate(_LUMINANCE)
    assert (paper < 60 and ink > 200) if is_dark else (paper > 240 and ink < 60)
    axis = page.evaluate(_AXIS_TEXT)
    assert axis == page.evaluate("getComputedStyle(document.querySelector('h2')).color")
    page.close()
