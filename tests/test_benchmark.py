"""Targets of the benchmark and its page; `scripts/benchmark` itself takes minutes."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

_SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture(scope="module")
def cases() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(_SCRIPTS))
        yield importlib.import_module("benchmark_cases")
    sys.modules.pop("benchmark_cases")


@pytest.fixture(scope="module")
def table(cases: ModuleType) -> Iterator[ModuleType]:
    yield importlib.import_module("benchmark_table")
    sys.modules.pop("benchmark_table")


def _result(case, **changes):
    stages = {"features": {"median_ms": 8.0, "p95_ms": 12.0}}
    result = {
        "name": case.name, "folder": case.folder, "mode": case.mode, "failed": "", "frames": 100,
        "posed": 98, "starting": 2, "segments": 1, "ate_m": 0.05, "ate_causal_m": 0.06,
        "path_m": 10.0, "ate_percent": 0.5, "t_rel_percent": 0.2,
        "rpe_m": 0.01, "rotation_deg": 0.1, "scale_percent": None, "same_bits": True,
        "wall_ms": 50.0, "limit_ms": 10.0, "tracking_fps": 25.0, "keyframes": 20,
        "peak_rss_mb": 200.0, "stages": stages,
    }  # fmt: skip
    return result | changes


def _missed(cases, case, **changes):
    return [
        target for target, reached in cases.judge(case, _result(case, **changes)) if not reached
    ]


def _report(results):
    return {
        "date": "today", "machine": "a machine", "versions": "vo 1", "config": "default",
        "set": [], "runs": 1, "start_up_s": 1.0, "results": results,
    }  # fmt: skip


def test_a_good_run_reaches_every_target(cases):
    case = cases.Case("some", "stereo", (), ate=0.1, scale=1.0)
    assert _missed(cases, case, scale_percent=-0.9) == []


@pytest.mark.parametrize(
    ("changes", "target"),
    [
        ({"ate_m": 0.11}, "ATE ≤ 0.10"),
        ({"ate_m": None}, "ATE ≤ 0.10"),
        ({"scale_percent": -1.1}, "scale within 1 %"),
        ({"ate_percent": 0.61}, "ATE ≤ 0.6 %"),
        ({"t_rel_percent": 0.31}, "t_rel ≤ 0.3 %"),
        ({"t_rel_percent": None}, "t_rel ≤ 0.3 %"),
        ({"posed": 97}, "frames ≥ 98"),
        ({"segments": 2}, "one segment"),
        ({"same_bits": False}, "same bits"),
        ({"failed": "error: no such folder"}, "runs to its end"),
    ],
)
def test_a_missed_target_is_named(cases, changes, target):
    case = cases.Case("some", "stereo", (), ate=0.1, scale=1.0, ate_percent=0.6, t_rel=0.3)
    assert _missed(cases, case, **{"scale_percent": 0.5, **changes}) == [target]


def test_only_runs_with_missed_targets_are_listed(cases):
    good, bad = cases.Case("good", "mono", (), ate=0.1), cases.Case("bad", "mono", (), ate=0.01)
    known = {case.name: case for case in (good, bad)}
    results = [_result(good), _result(bad, segments=2)]
    assert cases.missed(known, results) == ["bad mono: one segment; ATE ≤ 0.01"]


def test_on_a_hard_sequence_only_a_wrong_path_fails(cases):
    case = cases.Case("dark", "mono", (), hard=True)
    assert _missed(cases, case, posed=4, segments=2, ate_m=None) == []
    assert _missed(cases, case, posed=90, ate_m=0.21) == ["no wrong path"]
    assert _missed(cases, case, posed=90, ate_m=0.21, path_m=11.0) == []


def test_the_suite_counts_targets_and_shows_failures(cases, table):
    known = {case.name: case for case in cases.suite_cases(["01_easy", "02_hard_dark"])}
    assert [case.hard for case in known.values()] == [False, False, True, True]
    good, bad, *rest = known.values()
    results = [
        _result(good, ate_percent=0.2),
        _result(bad, ate_percent=0.51),
        _result(rest[0], failed="error: out of luck"),
    ]
    lines = table.suite_document(_report(results), known).splitlines()
    assert "8 of 10 targets" in " ".join(lines)
    assert any(line.startswith("| 01_easy | mono") and "| 0.51 |" in line for line in lines)
    assert any("failed: error: out of luck" in line for line in lines)
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


def test_the_page_shows_failures_and_peers(cases, table):
    peer = cases.Peer("other", "99/100", 0.051)
    good = cases.Case("good", "mono", (), ate=0.1, peers=(peer,))
    bad = cases.Case("bad", "mono", ())
    results = [_result(good), _result(bad, failed="error: out of luck")]
    page = table.document(_report(results), {case.name: case for case in (good, bad)})
    lines = page.splitlines()
    assert any("**vo** | 98/100" in line and "| 0.0500 |" in line for line in lines)
    assert any("| other | 99/100 |" in line and "0.051" in line for line in lines)
    assert any("failed: error: out of luck" in line for line in lines)
    accuracy = page.split("### Speed")[0].splitlines()
    assert len({line.count("|") for line in accuracy if line.startswith("|")}) == 1


def test_sections_are_wrapped_and_have_no_targets_in_tables(cases, table):
    case = cases.Case("some", "stereo", (), ate=0.1)
    page = table.document(_report([_result(case)]), {case.name: case})
    assert all(len(line) <= 100 for line in page.splitlines() if not line.startswith("|"))
    assert "≤" not in page


def test_the_cost_of_a_recording_is_relative_to_the_same_sequence(table):
    run = {"sequence": "hall", "name": "no recording", "wall_ms": 10.0, "kb": 0.0}
    recorded = {**run, "name": "--rrd-images full", "wall_ms": 12.5, "kb": 79.4}
    reading = [{"name": "EuRoC folder, PNG", "fps": 756.0, "cpu_ms": 2.4, "mb": 43.0}]
    report = {**_report([]), "reading": reading, "recording": [run, recorded]}
    lines = table.reading_document(report).splitlines()
    assert "| hall | no recording | 10.0 | – | – |" in lines
    assert "| hall | --rrd-images full | 12.5 | 25 | 79 |" in lines
