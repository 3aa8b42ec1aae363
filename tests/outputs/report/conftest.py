"""Two short runs of one recording, and a browser."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from vo.base.config import load_config
from vo.runs.run_recording import run

FRAMES = 14


@pytest.fixture(scope="session")
def report_runs(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Folders of a stereo and a mono run; not to be written to."""
    folder = tmp_path_factory.mktemp("report_runs")
    runs = [folder / "stereo", folder / "mono"]
    run(synthetic_stereo, runs[0], config=load_config("fast"), end=FRAMES)
    run(synthetic_stereo, runs[1], config=load_config("fast"), end=FRAMES, mode="mono")
    return runs


@pytest.fixture
def own_run(report_runs: list[Path], tmp_path: Path) -> Path:
    """The stereo run, to be changed."""
    return Path(shutil.copytree(report_runs[0], tmp_path / "run"))


@pytest.fixture(scope="session")
def chromium() -> str:
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found is not None:
            return found
    pytest.skip("no Chromium is installed (Debian: apt-get install chromium)")
