"""Runs `vo run` as a user would on every sequence, scores it, and prints a page of results."""

from __future__ import annotations

import argparse
import compileall
import json
import os
import platform
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from statistics import median_low
from typing import Any

from benchmark_cases import CASES, Case, hard_cases, missed, suite_cases
from benchmark_run import Result, measure_case
from benchmark_table import (
    document,
    generator_document,
    hard_document,
    reading_document,
    suite_document,
)
from common import EXPERIMENTS, ROOT, parser_of, suite, write_section, write_tum_calibration

PAGE = EXPERIMENTS / "benchmark-tables.md"


def main() -> None:
    """Measure, print the section of the page, and write it where requested."""
    options = _options()
    for package in ("vo", "data_synth"):  # as pip does for installed packages
        compileall.compile_dir(ROOT / package, quiet=1)
    with tempfile.TemporaryDirectory(prefix="vo-benchmark-") as name:
        work = Path(name)
        options.calibration = write_tum_calibration(work)
        section, text, report = _section(options, work)
    print(text)
    if options.json:
        options.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    if options.write:
        write_section(PAGE, section, text)


def _section(options: argparse.Namespace, work: Path) -> tuple[str, str, Result]:
    """Name, text and figures of the requested section of the page."""
    if options.generator:
        from benchmark_reading import measure_generator

        report = {**_conditions(options), "results": measure_generator(_say)}
        return "generator", generator_document(report), report
    if options.reading:
        from benchmark_reading import measure_reading, measure_recording

        sequences = (options.data / "kitti06_stereo_000-050", options.data / "rendered_hall_stereo")
        recording = [r for s in sequences if s.is_dir() for r in measure_recording(s, _say)]
        reading = measure_reading(options.cache, _say)
        report = {**_conditions(options), "reading": reading, "recording": recording}
        return "reading", reading_document(report), report
    is_rendered = options.synth or options.hard
    cases = _suite(options) if is_rendered else [(c, options.data / c.folder) for c in CASES]
    report = _measure(_chosen(cases, options), options, work)
    known = {case.name: case for case, _ in cases}
    for line in missed(known, report["results"]):
        _say(f"missed target: {line}")
    if options.hard:
        return "hard", hard_document(report, known), report
    if options.synth:
        return "suite", suite_document(report, known), report
    return "recordings", document(report, known), report


def _options() -> argparse.Namespace:
    shared = ("only", "data", "cache", "config", "set", "keep", "json", "write")
    parser = parser_of("benchmark", __doc__, *shared)
    add = parser.add_argument
    add("--synth", action="store_true", help="the synthetic suite instead of real recordings")
    add("--hard", action="store_true", help="the hard set, with and without inertial sensors")
    add("--generator", action="store_true", help="the speed of the generator of recordings")
    add("--reading", action="store_true", help="the speed of reading, and the cost of an .rrd")
    add("--runs", type=int, default=1, help="runs of each; that of median wall time counts")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error("--runs must be 1 or more")
    if options.write and options.only:
        parser.error("--write needs the whole set, without --only")
    return options


def _chosen(cases: list[tuple[Case, Path]], options: argparse.Namespace) -> list[tuple[Case, Path]]:
    """The requested cases whose recording exists, and its folder."""
    chosen = []
    for case, folder in cases:
        if options.only not in case.name:
            continue
        if folder.is_dir():
            chosen.append((case, folder))
        else:
            _say(f"{case.name}: {folder} does not exist, skipped")
    if not chosen:
        raise SystemExit("error: no sequence found; give --data DIR or another --only")
    return chosen


def _suite(options: argparse.Namespace) -> list[tuple[Case, Path]]:
    """The synthetic sequences; those missing in the cache are made."""
    folders = suite(options.cache, group="hard" if options.hard else "suite")
    cases_of = hard_cases if options.hard else suite_cases
    chosen = [case for case in cases_of(list(folders)) if options.only in case.name]
    return [(case, folders[case.folder]()) for case in chosen]


def _measure(
    chosen: list[tuple[Case, Path]], options: argparse.Namespace, work: Path
) -> dict[str, Any]:
    conditions = _conditions(options)
    results = [measure_case(case, folder, options, work, _say) for case, folder in chosen]
    return {
        **conditions,
        "start_up_s": median_low(r.get("start_up_s", 0.0) for r in results),
        "results": results,
    }


def _conditions(options: argparse.Namespace) -> dict[str, Any]:
    load = os.getloadavg()[0]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{_processor()}, {os.cpu_count()} cores, load {load:.1f} before the start",
        "versions": _versions(),
        "config": str(options.config),
        "set": options.set,
        "runs": options.runs,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _versions() -> str:
    from importlib.metadata import version

    from vo.base.version import __version__

    packages = ("opencv-python-headless", "gtsam", "numba", "numpy")
    names = [f"{name.removesuffix('-python-headless')} {version(name)}" for name in packages]
    return ", ".join([f"Python {platform.python_version()}", f"vo {__version__}", *names])


def _say(text: str, end: str = "\n") -> None:
    print(text, end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
