"""Runs `vo run` as a user would on every sequence there is, scores it, and shows it as a page."""

from __future__ import annotations

import argparse
import compileall
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from statistics import median_low
from typing import Any

import cv2
from benchmark_table import (
    CASES,
    Case,
    document,
    generator_document,
    reading_document,
    suite_cases,
    suite_document,
)

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "benchmarks.md"
VO = Path(sys.executable).with_name("vo")
LIMIT_FEATURES = 2000
TUM_CALIBRATION = """\
cam0:
  resolution: [640, 480]
  intrinsics: [535.4, 539.2, 320.1, 247.6]
"""

Result = dict[str, Any]


def main() -> None:
    """Measure, print the section of the page, and write what is asked for."""
    options = _options()
    for package in ("vo", "data_synth"):  # as pip leaves what it installs
        compileall.compile_dir(ROOT / package, quiet=1)
    with tempfile.TemporaryDirectory(prefix="vo-benchmark-") as name:
        work = Path(name)
        options.calibration = work / "tum.yaml"
        options.calibration.write_text(TUM_CALIBRATION, encoding="utf-8")
        section, text, report = _section(options, work)
    print(text)
    if options.json:
        options.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    if options.write:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(replaced(page, section, text), encoding="utf-8")


def _section(options: argparse.Namespace, work: Path) -> tuple[str, str, dict[str, Any]]:
    """Name, text and figures of the section of the page that was asked for."""
    if options.generator:
        from benchmark_generator import measure_generator

        report = {**_circumstances(options), "results": measure_generator(_say)}
        return "generator", generator_document(report), report
    if options.reading:
        from benchmark_reading import measure_reading, measure_recording

        sequences = (options.data / "kitti06_stereo_000-050", options.data / "rendered_hall_stereo")
        recording = [r for s in sequences if s.is_dir() for r in measure_recording(s, _say)]
        reading = measure_reading(options.cache, _say)
        report = {**_circumstances(options), "reading": reading, "recording": recording}
        return "reading", reading_document(report), report
    cases = _suite(options) if options.synth else [(c, options.data / c.folder) for c in CASES]
    report = _measure(_chosen(cases, options), options, work)
    known = {case.name: case for case, _ in cases}
    if options.synth:
        return "suite", suite_document(report, known), report
    return "recordings", document(report, known), report


def replaced(page: str, section: str, text: str) -> str:
    """The page with the text between a section's marks exchanged."""
    begin, end = f"<!-- {section}: begin -->", f"<!-- {section}: end -->"
    before, rest = page.split(begin)
    return f"{before}{begin}\n\n{text}\n\n{end}{rest.split(end)[1]}"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/benchmark", description=__doc__)
    add = parser.add_argument
    add("--synth", action="store_true", help="the synthetic suite instead of real recordings")
    add("--generator", action="store_true", help="how fast synthetic recordings are made")
    add("--reading", action="store_true", help="how fast recordings are read, what an .rrd costs")
    add("--cache", type=Path, default=ROOT / "out" / "synth", help="where these are kept")
    add("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder of sequences")
    add(
        "--runs",
        type=int,
        default=1,
        help="runs of each, of which the one with the median wall time counts",
    )
    add("--config", default="default", help="preset or file for `vo run`")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="setting for `vo run`")
    add("--only", default="", metavar="TEXT", help="only where sequence and mode contain this")
    add("--keep", type=Path, metavar="DIR", help="keep the folder of each first run in here")
    add("--json", type=Path, metavar="FILE", help="write every figure into this file")
    add("--write", action="store_true", help="write into docs/benchmarks.md")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error("--runs must be 1 or more")
    if options.write and options.only:
        parser.error("--write is for the whole set, without --only")
    return options


def _chosen(cases: list[tuple[Case, Path]], options: argparse.Namespace) -> list[tuple[Case, Path]]:
    """The cases asked for whose recording is there, and where it is."""
    chosen = []
    for case, folder in cases:
        if options.only not in case.name:
            continue
        if folder.is_dir():
            chosen.append((case, folder))
        else:
            _say(f"{case.name}: {folder} is not there, left out")
    if not chosen:
        raise SystemExit("error: no sequence to run on; give --data DIR or another --only")
    return chosen


def _suite(options: argparse.Namespace) -> list[tuple[Case, Path]]:
    """The synthetic sequences, made where they are not in the cache yet."""
    from data_synth.cache import cached_sequence
    from data_synth.recipe import load_recipe, recipe_folder

    recipes = {p.stem: p for p in sorted((recipe_folder() / "suite").glob("*.yaml"))}
    folders: dict[str, Path] = {}
    cases = []
    for case in suite_cases(list(recipes)):
        if options.only not in case.name:
            continue
        if case.folder not in folders:
            recipe = load_recipe(recipes[case.folder])
            _say(f"{case.folder}: {recipe.about}")
            folders[case.folder] = cached_sequence(recipe, options.cache, case.folder)
        cases.append((case, folders[case.folder]))
    return cases


def _measure(
    chosen: list[tuple[Case, Path]], options: argparse.Namespace, work: Path
) -> dict[str, Any]:
    circumstances = _circumstances(options)
    results = [_case(case, folder, options, work) for case, folder in chosen]
    return {
        **circumstances,
        "start_up_s": median_low(r["start_up_s"] for r in results),
        "results": results,
    }


def _circumstances(options: argparse.Namespace) -> dict[str, Any]:
    load = os.getloadavg()[0]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{_processor()}, {os.cpu_count()} cores, load {load:.1f} before the start",
        "versions": _versions(),
        "config": str(options.config),
        "set": options.set,
        "runs": options.runs,
    }


def _case(case: Case, folder: Path, options: argparse.Namespace, work: Path) -> Result:
    """The run of the median wall time on one sequence."""
    _say(f"{case.name}: ", end="")
    scratch = work / "out"
    result: Result = {"name": case.name, "folder": case.folder, "mode": case.mode, "failed": ""}
    for _ in range(2):  # the first compiles what was never compiled on this machine
        _, result["start_up_s"] = _run(case, folder, scratch, options, "--end", "2")
    runs, prints = [], set()
    for number in range(options.runs):
        out = options.keep / case.name.replace(" ", "_") if options.keep and not number else scratch
        failed, wall_s = _run(case, folder, out, options)
        if failed:
            _say(f"failed: {failed}")
            return {**result, "failed": failed}
        prints.add(hashlib.sha256((out / "trajectory.tum").read_bytes()).hexdigest())
        runs.append({**_of_summary(out, wall_s), **_errors(case, out, folder)})
    runs.sort(key=lambda run: run["wall_ms"])
    result |= runs[(len(runs) - 1) // 2]
    result["same_bits"] = len(prints) == 1 if options.runs > 1 else None
    result["limit_ms"] = limit_ms(folder, case.images, result["frames"])
    ate = "no path" if result["ate_m"] is None else f"ATE {result['ate_m']:.4f} m"
    _say(f"{result['posed']}/{result['frames']} frames, {ate}, {result['wall_ms']:.0f} ms/frame")
    return result


def _run(
    case: Case, folder: Path, out: Path, options: argparse.Namespace, *more: str
) -> tuple[str, float]:
    """`vo run` on a sequence: why it failed, or nothing, and its wall time in seconds."""
    command = [str(VO), "run", str(folder), "--output", str(out), "--quiet", *more]
    command += ["--mode", case.mode, "--config", str(options.config)]
    command += [part for setting in options.set for part in ("--set", setting)]
    if case.folder.startswith("tum_"):
        command += ["--calibration", str(options.calibration)]
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wall_s = time.perf_counter() - begin
    if done.returncode == 0 and "Warning:" not in done.stderr:
        return "", wall_s
    lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return lines[-1] if done.returncode else f"a warning: {lines[0]}", wall_s


def _of_summary(out: Path, wall_s: float) -> Result:
    """What a run says of itself, and the wall time of the whole command."""
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return {
        "frames": summary["frames"],
        "posed": summary["tracked"],
        "starting": summary["starting"],
        "lost": summary["lost"],
        "segments": len(summary["segments"]),
        "keyframes": summary["keyframes"],
        "tracking_fps": summary["frames_per_s"],
        "stages": summary["stages"],
        "peak_rss_mb": summary["peak_rss_mb"],
        "wall_ms": 1e3 * wall_s / summary["frames"],
    }


def _errors(case: Case, out: Path, folder: Path) -> Result:
    """Distance from the truth of the longest segment; None where nothing can be said."""
    smoothed = _evaluated(out / "trajectory.tum", folder, case)
    causal = _evaluated(out / "causal.tum", folder, case)
    causal_m = None if causal is None else causal.ate.translation.rmse
    if smoothed is None:
        keys = ("ate_m", "ate_percent", "t_rel_percent", "path_m", "rpe_m", "rotation_deg")
        return {**dict.fromkeys((*keys, "scale_percent")), "ate_causal_m": causal_m}
    steps, segments, ate_m = smoothed.rpe_frames, smoothed.segments, smoothed.ate.translation.rmse
    stereo = case.mode == "stereo"
    return {
        "ate_m": ate_m,
        "ate_causal_m": causal_m,
        "path_m": smoothed.path_m,
        "ate_percent": 100.0 * ate_m / smoothed.path_m if smoothed.path_m > 0 else None,
        "t_rel_percent": None if segments is None else segments.translation_percent,
        "rpe_m": None if steps is None else steps.translation.rmse,
        "rotation_deg": None if steps is None else steps.rotation.rmse,
        "scale_percent": smoothed.alignment.scale_error_percent if stereo else None,
    }


def _evaluated(estimate: Path, folder: Path, case: Case) -> Any:
    from vo.errors import VoError
    from vo.evaluation.inputs import load_inputs
    from vo.evaluation.report import evaluate

    try:
        inputs = load_inputs(estimate, folder)
        align = "se3" if case.mode == "stereo" else "sim3"
        return evaluate(inputs.estimate, inputs.reference, align)
    except VoError:
        return None


def limit_ms(folder: Path, patterns: tuple[str, ...], frames: int) -> float:
    """Milliseconds by frame to decode the images and extract ORB in two threads, at best."""
    files = [file for pattern in patterns for file in sorted(folder.glob(pattern))]
    own = threading.local()

    def work(file: Path) -> None:
        if not hasattr(own, "orb"):
            own.orb = cv2.ORB_create(LIMIT_FEATURES)
        own.orb.detectAndCompute(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), None)

    with ThreadPoolExecutor(max_workers=2) as pool:
        list(pool.map(work, files[:4]))  # threads and buffers are made
        spent_s = []
        for _ in range(3):
            begin = time.perf_counter()
            list(pool.map(work, files))
            spent_s.append(time.perf_counter() - begin)
    return 1e3 * min(spent_s) / frames


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _versions() -> str:
    from importlib.metadata import version

    packages = ("vo", "opencv-python-headless", "gtsam", "numba", "numpy")
    names = [f"{name.removesuffix('-python-headless')} {version(name)}" for name in packages]
    return ", ".join([f"Python {platform.python_version()}", *names])


def _say(text: str, end: str = "\n") -> None:
    print(text, end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
