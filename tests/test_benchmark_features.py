"""The table and plot of docs/features.md; `scripts/benchmark --features` itself takes minutes."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from vo.engine.features.descriptors import DESCRIPTORS
from vo.engine.features.detectors import DETECTORS

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def benchmark() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "scripts"))
        yield importlib.import_module("benchmark_features")
    sys.modules.pop("benchmark_features")


def row(method: str, gap: int, good: float, pairs: int = 2, **changes: Any) -> dict[str, Any]:
    values = {
        "recording": "walk", "method": method, "gap": gap, "pairs": pairs, "features": 1000.0,
        "matches": 300.0, "matching_score": 0.3, "precision": 0.9, "inlier_ratio": 0.8,
        "good_ratio": good, "rotation_deg": 0.1, "direction_deg": 1.0, "extract_ms": 4.0,
        "match_ms": 2.0, "repeatability": float("nan"),
    }  # fmt: skip
    return values | changes


def report(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {"count": 1024, "runs": 3, "results": rows, "date": "a", "machine": "b", "versions": "c"}


def test_the_best_method_is_first_and_times_are_ratios(benchmark: ModuleType) -> None:
    rows = [row("orb", gap, 0.5) for gap in (1, 5, 15, 30)]
    rows += [row("sift, ratio 0.7", gap, 1.0, extract_ms=40.0) for gap in (1, 5, 15, 30)]
    lines = benchmark.features_document(report(rows)).splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert table[2].startswith("| `sift`, ratio 0.7 | 1000 | 0.80 | 1.00 | 1.00 | 1.00 | 1.00 |")
    assert table[2].endswith("| 8.2 |")
    assert table[3].endswith("| 1 |")
    assert len({line.count("|") for line in table}) == 1
    assert "8 pairs of 1 recordings" in " ".join(lines)


def test_recordings_are_pooled_by_their_pairs(benchmark: ModuleType, tmp_path: Path) -> None:
    rows = [row("orb", 1, 1.0, pairs=3), row("orb", 1, 0.0, pairs=1, recording="drive")]
    (merged,) = benchmark.pooled(rows)
    assert (merged.pairs, merged.good_ratio) == (4, 0.75)
    benchmark.plot_features(tmp_path / "plot.png", report(rows))
    assert (tmp_path / "plot.png").stat().st_size > 1000


def test_every_method_of_the_benchmark_exists(benchmark: ModuleType) -> None:
    names = [method.name for method in benchmark.benchmark_methods()]
    assert len(names) == len(set(names)) > 20
    assert {"orb", "sift", "fast/klt", "sift/flann", "orb, one direction"} <= set(names)


def test_the_page_names_every_detector_and_descriptor() -> None:
    page = (ROOT / "docs" / "features.md").read_text(encoding="utf-8")
    assert [name for name in (*DETECTORS, *DESCRIPTORS) if f"`{name}`" not in page] == []
