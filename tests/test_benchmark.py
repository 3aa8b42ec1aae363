"""The benchmark's judgement and its page; `scripts/benchmark` itself takes minutes."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

_FILE = Path(__file__).parent.parent / "scripts" / "benchmark_table.py"


@pytest.fixture(scope="module")
def table() -> ModuleType:
    spec = importlib.util.spec_from_file_location("benchmark_table", _FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["benchmark_table"] = module
    spec.loader.exec_module(module)
    return module


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


def _missed(table, case, **changes):
    return [goal for goal, ok in table.judge(case, _result(case, **changes)) if not ok]


def test_a_good_run_reaches_every_goal(table):
    case = table.Case("some", "stereo", (), ate=0.1, scale=1.0)
    assert _missed(table, case, scale_percent=-0.9) == []


@pytest.mark.parametrize(
    ("changes", "goal"),
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
def test_a_missed_goal_is_named(table, changes, goal):
    case = table.Case("some", "stereo", (), ate=0.1, scale=1.0, ate_percent=0.6, t_rel=0.3)
    assert _missed(table, case, **{"scale_percent": 0.5, **changes}) == [goal]


def test_where_there_is_little_to_see_only_a_wrong_path_fails(table):
    case = table.Case("dark", "mono", (), hard=True)
    assert _missed(table, case, posed=4, segments=2, ate_m=None) == []
    assert _missed(table, case, posed=90, ate_m=0.21) == ["no wild path"]
    assert _missed(table, case, posed=90, ate_m=0.21, path_m=11.0) == []


def test_the_suite_shows_what_fails_as_failing(table):
    cases = {case.name: case for case in table.suite_cases(["01_easy", "02_hard_dark"])}
    assert [case.hard for case in cases.values()] == [False, False, True, True]
    good, bad, *rest = cases.values()
    report = {
        "date": "today", "machine": "a machine", "versions": "vo 1", "config": "default",
        "set": [], "runs": 1, "start_up_s": 1.0,
        "results": [
            _result(good, ate_percent=0.2), _result(bad, ate_percent=0.51),
            _result(rest[0], failed="error: out of luck"),
        ],
    }  # fmt: skip
    lines = table.suite_document(report, cases).splitlines()
    assert any("8 of 10 goals" in line for line in lines)
    assert any(line.startswith("| 01_easy | stereo") and "✗" not in line for line in lines)
    assert any(line.startswith("| 01_easy | mono") and "✗ ATE ≤ 0.5 %" in line for line in lines)
    assert any("failed: error: out of luck" in line for line in lines)
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


def test_the_page_shows_failures_and_peers(table):
    peer = table.Peer("other", "99/100", 0.051)
    good = table.Case("good", "mono", (), ate=0.1, peers=(peer,))
    bad = table.Case("bad", "mono", ())
    report = {
        "date": "today", "machine": "a machine", "versions": "vo 1", "config": "default",
        "set": [], "runs": 3, "start_up_s": 1.0,
        "results": [_result(good), _result(bad, failed="error: out of luck")],
    }  # fmt: skip
    page = table.document(report, {case.name: case for case in (good, bad)})
    lines = page.splitlines()
    assert any("**vo** | 98/100" in line and "✓ ATE ≤ 0.10" in line for line in lines)
    assert any("| other | 99/100 |" in line and "0.051" in line for line in lines)
    assert any("failed: error: out of luck" in line for line in lines)
    rows = [line.count("|") for line in lines if line.startswith("| bad") or "**vo**" in line]
    assert len(set(rows)) == 1
