"""`vo view`: choice of the file, error messages, and display in a real browser."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.config import load_config
from vo.cli.app import app
from vo.cli.view import find_recording
from vo.runs.run_recording import run

VO = Path(sys.executable).with_name("vo")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRAWN_IN_SOFTWARE = [
    "--no-sandbox",
    "--disable-background-networking",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]


@pytest.fixture(scope="module")
def recorded(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run with a recording in it."""
    folder = tmp_path_factory.mktemp("recorded")
    run(synthetic_stereo, folder, config=load_config("fast"), end=8, rrd=folder / "run.rrd")
    return folder


@pytest.fixture
def page(recorded: Path) -> Iterator[str]:
    """Address printed by `vo view --web`, whose exit status is checked after SIGTERM."""
    command = [VO, "view", recorded, "--web"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as serving:
        assert serving.stdout is not None
        yield serving.stdout.readline().rpartition(" is at ")[2].strip()
        serving.send_signal(signal.SIGTERM)
        assert serving.wait(20) == 0


def test_the_newest_recording_of_a_folder_is_opened(recorded: Path) -> None:
    assert find_recording(recorded) == recorded / "run.rrd"


def view(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["view", *map(str, words)])
    return result.exit_code, result.stderr


def test_bad_recordings_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.rrd").touch()
    (tmp_path / "other.rrd").write_bytes(b"\x89PNG" * 100)
    for name, words in (
        ("none.rrd", "does not exist"),
        ("empty.rrd", "is empty"),
        ("other.rrd", "is not an .rrd file"),
    ):
        code, message = view(tmp_path / name)
        assert (code, message.count("\n")) == (1, 1)
        assert message.startswith(f"error: {tmp_path / name} {words}")
    (tmp_path / "folder").mkdir()
    code, message = view(tmp_path / "folder")
    assert code == 1
    assert "contains no .rrd file" in message and "--rrd" in message


def test_no_screen_is_one_line(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if sys.platform == "darwin":
        pytest.skip("there is always a screen")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    code, message = view(recorded)
    assert (code, message.count("\n")) == (1, 1)
    assert message.startswith("error: a viewer cannot be opened here: ")
    assert message.endswith("; use --web\n")  # `vo view` has no --serve


def test_serves_page_and_recording_to_this_machine_only(page: str, recorded: Path) -> None:
    viewer, _, data = page.partition("?url=")
    assert viewer.startswith("http://127.0.0.1:") and data.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(viewer) as answer:
        assert b"<html" in answer.read().lower()
    with urllib.request.urlopen(data) as answer:
        assert answer.read() == (recorded / "run.rrd").read_bytes()
        assert "Access-Control-Allow-Origin" not in answer.headers
    with pytest.raises(urllib.error.HTTPError):
        urllib.request.urlopen(data.rpartition("/")[0] + "/../summary.json")
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen("/".join([*data.split("/")[:3], "recording.rrd"]))


@pytest.mark.parametrize(
    ("origin", "is_allowed"),
    [
        ("http://127.0.0.1:{port}", True),
        ("http://localhost:{port}", True),
        ("https://127.0.0.1:{port}", False),
        ("http://127.0.0.1:1", False),
        ("http://evil.example:{port}", False),
        ("http://127.0.0.1.evil.example:{port}", False),
        ("http://127.0.0.1:x", False),
        ("null", False),
    ],
)
def test_only_pages_of_the_viewer_can_read_the_recording(
    page: str, origin: str, is_allowed: bool
) -> None:
    viewer, _, data = page.partition("?url=")
    given = origin.format(port=viewer.rstrip("/").rpartition(":")[2])
    with urllib.request.urlopen(urllib.request.Request(data, headers={"Origin": given})) as answer:
        allowed = answer.headers["Access-Control-Allow-Origin"]
    assert allowed == (given if is_allowed else None)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "10.0.0.1", ""])
def test_requests_to_other_hosts_are_refused(page: str, host: str) -> None:
    data = page.partition("?url=")[2]
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(urllib.request.Request(data, headers={"Host": host}))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_a_browser_draws_the_recording(page: str) -> None:
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=DRAWN_IN_SOFTWARE)
        empty = _settled_shot(browser, page.partition("?")[0] + "?renderer=webgl", None)
        drawn = _settled_shot(browser, page + "&renderer=webgl", empty)
        browser.close()
    differs = (np.abs(drawn.astype(int) - empty) > 25).any(axis=2)
    assert differs.mean() > 0.3
    left, right = drawn[:, :400], drawn[:, 400:]
    assert len(np.unique(left.reshape(-1, 3), axis=0)) > 100  # landmarks on the dark ground
    assert right[:250].std() > 20.0  # photographs


def _settled_shot(browser: Any, address: str, other_than: np.ndarray | None) -> np.ndarray:
    """The page once it no longer changes, and shows something else than `other_than`."""
    tab = browser.new_page(viewport={"width": 800, "height": 600})
    tab.goto(address)
    give_up, last = time.monotonic() + 90, None
    while time.monotonic() < give_up:
        time.sleep(2.0)
        data = np.frombuffer(tab.screenshot(timeout=60_000), dtype=np.uint8)
        shot = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))
        is_new = other_than is None or (np.abs(shot.astype(int) - other_than) > 25).mean() > 0.1
        has_content = shot.std() > 10.0
        if (
            last is not None
            and has_content
            and is_new
            and np.abs(shot.astype(int) - last).mean() < 3
        ):
            break
        last = shot
    tab.close()
    return shot
