"""The table of runs with learned features."""

from __future__ import annotations

from typing import Any

import benchmark_learned


def result(name: str, method: str, sha256: str, **given: Any) -> dict[str, Any]:
    folder, mode = name.split()
    return {
        "name": name,
        "folder": folder,
        "mode": mode,
        "method": method,
        "posed": 50,
        "frames": 51,
        "segments": 1,
        "ate_m": 0.02,
        "path_m": 59.9,
        "cpu_s": 2.0,
        "sha256": sha256,
        **given,
    }


def test_the_table_tells_where_rescue_changes_nothing_and_what_it_costs() -> None:
    results = [
        result("road stereo", "ORB", "a"),
        result("road stereo", "ORB, rescue by XFeat", "a", cpu_s=2.1),
        result("wall mono", "ORB", "b", posed=4),
        result("wall mono", "ORB, rescue by XFeat", "c", posed=21, segments=3, cpu_s=9.0),
        result("wall mono", "XFeat", "d", ate_m=None, path_m=None, posed=0, segments=0),
    ]
    report = {
        "results": results,
        "runs": 2,
        "config": "default",
        "set": [],
        "date": "today",
        "machine": "one core",
        "versions": "vo 1",
    }
    lines = benchmark_learned.learned_document(report).splitlines()
    assert "| recording | mode | ORB | ORB, rescue by XFeat | XFeat |" in lines
    road = "50/51; 0.0200 of 59.9 m"
    assert f"| road | stereo | {road} | {road} | – |" in lines
    wall = "4/51; 0.0200 of 59.9 m | 21/51 in 3; 0.0200 of 59.9 m | 0/51"
    assert f"| wall | mono | {wall} |" in lines
    text = " ".join(lines)
    assert "the bytes of ORB on 1 of these: road stereo." in text
    assert "1.05 times that of ORB in total" in text
    assert "It changes the path on: wall mono." in text
    assert all(len(line) <= 100 for line in lines if not line.startswith("|"))
