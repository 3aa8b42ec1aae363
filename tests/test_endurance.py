"""Memory and speed of a long run, as `scripts/endurance` judges them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

FRAMES = 4000


@pytest.fixture(scope="module")
def endurance() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parent.parent / "scripts"))
        yield importlib.import_module("endurance")
    sys.modules.pop("endurance")


def samples(endurance: ModuleType, memory_growth: float = 1.0, speed: float = 1.0) -> list[Any]:
    """A run of 100 frames per CPU second, with another memory and speed in its second half."""
    found, cpu_s = [], 0.0
    for frames in range(50, FRAMES + 1, 50):
        late = frames > FRAMES // 2
        cpu_s += 0.5 / (speed if late else 1.0)
        found.append(endurance.Sample(frames, 300.0 * (memory_growth if late else 1.0), cpu_s))
    return found


def test_a_constant_run_passes(endurance: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    endurance._judge(samples(endurance), {"tracked": FRAMES}, FRAMES)
    printed = capsys.readouterr().out
    assert "300.0 MiB at the end: 1.000" in printed
    assert "100.00 in the last: 1.000" in printed


@pytest.mark.parametrize("change", [{"memory_growth": 1.11}, {"speed": 0.89}])
def test_growing_memory_or_falling_speed_fails(
    endurance: ModuleType, change: dict[str, float]
) -> None:
    with pytest.raises(SystemExit) as ended:
        endurance._judge(samples(endurance, **change), {"tracked": FRAMES}, FRAMES)
    assert ended.value.code == 1


def test_lines_of_a_growing_file_are_counted_once(endurance: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "frames.csv.partial"
    counter = endurance._LineCounter(path)
    assert counter.count() == 0  # not created yet
    path.write_text("a\nb\nhalf")
    assert counter.count() == 2
    with path.open("a") as file:
        file.write(" a line\n")
    assert counter.count() == 3
    path.rename(tmp_path / "frames.csv")
    assert counter.count() == 3
