"""The page in a real browser."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from vo.cli.app import app
from vo.outputs.report.run_folder import read_run

playwright = pytest.importorskip("playwright.sync_api")

_INVISIBLE = """() => [...document.querySelectorAll('figure:not(.flat *) > svg')].filter(svg => {
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
_TOO_WIDE = """() => [...document.querySelectorAll('figure, canvas, svg, button, .tools, .key')]
    .filter(each => !each.closest('[hidden]') && each.getBoundingClientRect().right > 390.5)
    .map(each => each.outerHTML.slice(0, 80))"""
_PIXELS = "() => document.querySelector('canvas').toDataURL()"
_TIPS = """() => {
    const canvas = document.querySelector('canvas'), found = new Set();
    const {clientWidth: width, clientHeight: height} = canvas;
    for (let x = 0; x < width; x += 9) for (let y = 0; y < height; y += 9) {
        const box = canvas.getBoundingClientRect();
        canvas.dispatchEvent(new PointerEvent('pointermove',
            {clientX: box.left + x, clientY: box.top + y, pointerId: 9}));
        found.add(document.querySelector('figure.view .tip').textContent);
    }
    return [...found].filter(Boolean);
}"""
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


def test_nothing_is_cut_off_on_a_phone(browser: Any, report: Path) -> None:
    page, _ = open_page(browser, report, viewport={"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(_TOO_WIDE) == []
    page.close()


def test_the_path_is_turned_and_shows_values(browser: Any, report: Path) -> None:
    page, seen = open_page(browser, report)
    view, canvas = page.locator("figure.view"), page.locator("canvas")
    assert not page.locator("#plot-path").is_visible()  # the view replaces it
    view.locator("[data-view=above]").click()
    pictures = {page.evaluate(_PIXELS)}
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 60)
    page.mouse.up()
    pictures.add(page.evaluate(_PIXELS))
    for name in ("run", "error", "speed", "sigma"):
        view.locator("select").select_option(name)
        pictures.add(page.evaluate(_PIXELS))
    page.mouse.wheel(0, -300)
    pictures.add(page.evaluate(_PIXELS))
    assert len(pictures) == 7 - 1  # the view starts with one of the colours
    texts = page.evaluate(_TIPS)
    assert texts and all(text.startswith("frame ") and " m/s" in text for text in texts)
    assert {int(text.split()[1].strip(",")) for text in texts} <= set(range(14))
    assert not [each for each in seen if "error" in each]
    page.close()


def test_a_figure_shows_the_values_under_the_pointer(
    browser: Any, report: Path, report_runs: list[Path]
) -> None:
    page, _ = open_page(browser, report)
    figure = page.locator("#plot-counts")
    figure.scroll_into_view_if_needed()
    box = figure.locator("svg").bounding_box()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.4 * box["height"])
    time, *curves = figure.locator(".tip").inner_text().split("\n")
    seconds, inliers = float(time.split()[-1]), float(curves[-1].split()[-1])
    table = read_run(report_runs[0]).frames
    assert table is not None
    known = np.interp(seconds, (table.stamp_ns - table.stamp_ns[0]) * 1e-9, table.inliers)
    assert curves[-1].startswith("inliers: ") and abs(inliers - known) < 1.5
    page.close()


def test_without_script_the_path_is_a_picture(browser: Any, report: Path) -> None:
    page, _ = open_page(browser, report, java_script_enabled=False)
    assert page.locator("#plot-path svg").is_visible()
    assert not page.locator("figure.view").is_visible()
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
