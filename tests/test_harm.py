"""Additions don't make paths worse in silence; `scripts/harm` measures all recordings."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

import harm  # noqa: E402
from harm import Run  # noqa: E402


@pytest.mark.parametrize(
    ("complete", "without", "word"),
    [
        (Run(0.020, True, ()), Run(0.020, True, ()), ""),
        (Run(0.0229, True, ()), Run(0.020, True, ()), ""),
        (Run(0.0231, True, ()), Run(0.020, True, ()), "**harm**"),
        (Run(0.0231, True, ("lens",)), Run(0.020, True, ()), "worse, and said"),
        (Run(0.0231, True, ("lens",)), Run(0.020, True, ("lens",)), "**harm**"),
        (Run(0.5, False, ()), Run(0.020, True, ()), "worse, and said"),
        (Run(None, True, ()), Run(0.020, True, ()), "**harm**"),
        (Run(0.020, True, ()), Run(0.5, True, ()), "helps"),
        (Run(0.020, True, ()), Run(None, True, ()), "helps"),
    ],
)
def test_a_path_may_not_become_worse_without_a_word(complete: Run, without: Run, word: str) -> None:
    assert harm.judge(complete, without) == word


@pytest.mark.parametrize(("error", "word"), [(2.9, ""), (-3.1, "**harm**")])
def test_a_scale_may_not_be_wrong_by_more_than_it_says(error: float, word: str) -> None:
    scaled = Run(0.020, True, (), scale=(error, 1.0))
    assert harm.judge(scaled, Run(0.020, True, ())) == word


@pytest.mark.parametrize("name", ["kitti06_stereo_000-050", "rendered_hall_stereo"])
def test_no_addition_harms_the_start_of_a_recording(shared_data: Path, name: str) -> None:
    rows = list(harm.rows(shared_data / name, end=40))
    for addition in harm.ADDITIONS:
        assert sum(addition.name in row for row in rows) == len(addition.modes), addition.name
    assert any("positions" in row for row in rows)
    assert not [row for row in rows if "**harm**" in row]
