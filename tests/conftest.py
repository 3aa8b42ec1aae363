"""Fixtures for every room's tests."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def synthetic_stereo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty stereo frames with ground truth in the EuRoC layout; not to be written to."""
    from data_synth.recipe import load_recipe
    from data_synth.sequence import make_sequence

    folder = tmp_path_factory.mktemp("synthetic") / "walk"
    make_sequence(folder, load_recipe("demo", ["seconds=2", "motion=handheld", "scale=0.625"]))
    return folder


@pytest.fixture
def shared_data() -> Path:
    """Folder of the real sequences beside the checkout; the test is skipped where it is absent."""
    folder = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real sequences are not at {folder}")
    return folder
