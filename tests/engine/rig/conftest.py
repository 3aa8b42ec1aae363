"""The walk that several tests use."""

from __future__ import annotations

import pytest
from rig_walks import BACK_TO_BACK, FORWARD_PAIR_AND_SIDES, Walk, render


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Four seconds in a room with four cameras, by hand."""
    settings = ["world=room", "motion=handheld", "seconds=4", "fps=10"]
    return render(FORWARD_PAIR_AND_SIDES, tmp_path_factory.mktemp("walk"), settings)


@pytest.fixture(scope="session")
def apart(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Eight seconds in a room with two cameras back to back, which see nothing in common."""
    settings = ["world=room", "motion=handheld", "seconds=8", "fps=10"]
    return render(BACK_TO_BACK, tmp_path_factory.mktemp("apart"), settings)
