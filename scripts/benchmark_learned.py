"""`vo run` with ORB, with learned features, and with these only where ORB fails."""

from __future__ import annotations

import argparse
import copy
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmark_cases import Case
from benchmark_run import errors_of, run_case, summary_of
from benchmark_table import made_by, number, paragraph, run_conditions, table

Result = dict[str, Any]

METHODS = {
    "ORB": (),
    "ORB, rescue by XFeat": ("features.rescue=xfeat",),
    "XFeat": ("features.detector=xfeat",),
    "XFeat + LighterGlue": ("features.detector=xfeat", "matching.method=lighterglue"),
    "ALIKED-t16": ("features.detector=aliked-t16",),
}
BASE, RESCUE = "ORB", "ORB, rescue by XFeat"


def measure_learned(
    cases: Sequence[tuple[Case, Path]],
    options: argparse.Namespace,
    work: Path,
    say: Callable[..., None],
) -> list[Result]:
    """A result for each recording and method; methods that cannot run here are left out."""
    results = []
    for case, folder in cases:
        for method, settings in METHODS.items():
            chosen = copy.copy(options)
            chosen.set = [*options.set, *settings]
            out = work / "learned"
            cpu_s = []
            for _ in range(options.runs):
                failed, run = run_case(case, folder, out, chosen)
                cpu_s.append(run.cpu_s)
                if failed:
                    break
            if failed:
                say(f"{case.name}, {method}: {failed}")
                continue
            figures = {**summary_of(run), **errors_of(case, out, folder)}
            path = (out / "trajectory.tum").read_bytes()
            results.append({
                **figures, "name": case.name, "folder": case.folder, "mode": case.mode,
                "method": method, "cpu_s": min(cpu_s), "sha256": hashlib.sha256(path).hexdigest(),
            })  # fmt: skip
            say(f"{case.name}, {method}: {_cell(results[-1])}, {min(cpu_s):.1f} s")
    return results


def learned_document(report: Result) -> str:
    """The table, and what rescue costs and changes where ORB is not lost."""
    results = report["results"]
    by_case: dict[str, dict[str, Result]] = {}
    for result in results:
        by_case.setdefault(result["name"], {})[result["method"]] = result
    methods = [m for m in METHODS if any(m in of_case for of_case in by_case.values())]
    rows = []
    for of_case in by_case.values():
        first = next(iter(of_case.values()))
        cells = [_cell(of_case[m]) if m in of_case else "–" for m in methods]
        rows.append([first["folder"], first["mode"], *cells])
    same, other = [], []
    for name, of_case in by_case.items():
        if BASE in of_case and RESCUE in of_case:
            is_same = of_case[BASE]["sha256"] == of_case[RESCUE]["sha256"]
            (same if is_same else other).append(name)
    ratios = [by_case[n][RESCUE]["cpu_s"] / by_case[n][BASE]["cpu_s"] for n in same]
    total = sum(by_case[n][RESCUE]["cpu_s"] for n in same)
    total /= sum(by_case[n][BASE]["cpu_s"] for n in same) or 1.0
    note = (
        "Frames with a pose, the number of segments if there are several, and ATE of the longest "
        "segment of its length (smoothed poses, aligned by SE(3) in stereo and Sim(3) in mono)."
    )
    bits = (
        f"Rescue gives the bytes of ORB on {len(same)} of these: {'; '.join(same)}. CPU time on "
        f"them, of both processes: {number(total, 2)} times that of ORB in total, "
        f"{number(min(ratios, default=None), 2)} to {number(max(ratios, default=None), 2)} on each "
        f"(minimum of {report['runs']} runs each). It changes the path on: {'; '.join(other)}."
    )
    return "\n".join([
        *made_by(f"--learned --runs {report['runs']} --write", run_conditions(report)),
        "",
        *paragraph(note),
        "",
        *table(["recording", "mode", *methods], rows),
        "",
        *paragraph(bits),
    ])  # fmt: skip


def _cell(result: Result) -> str:
    """Frames with a pose, segments if there are several, and ATE of the longest segment."""
    text = f"{result['posed']}/{result['frames']}"
    if result["segments"] > 1:
        text += f" in {result['segments']}"
    if result["ate_m"] is None:
        return text
    return f"{text}; {result['ate_m']:.4f} of {result['path_m']:.1f} m"
