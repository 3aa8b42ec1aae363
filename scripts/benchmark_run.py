"""Runs `vo run` on one sequence of the benchmark, and scores it."""

from __future__ import annotations

import argparse
import hashlib
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
from benchmark_cases import Case
from common import VoRun, options_of, run_vo

LIMIT_FEATURES = 2000

Result = dict[str, Any]
Say = Callable[..., None]


def measure_case(
    case: Case, folder: Path, options: argparse.Namespace, work: Path, say: Say
) -> Result:
    """The run of median wall time on one sequence.

    `options`: those of the command line, with `calibration` for TUM's sequence. `say`: prints a
    message of progress.
    """
    say(f"{case.name}: ", end="")
    scratch = work / "out"
    result: Result = {"name": case.name, "folder": case.folder, "mode": case.mode, "failed": ""}
    for _ in range(
        0 if options.hard else 2
    ):  # the first one compiles if this machine has not compiled before
        result["start_up_s"] = run_case(case, folder, scratch, options, "--end", "2")[1].wall_s
    runs, digests = [], set()
    for number in range(options.runs):
        out = options.keep / case.name.replace(" ", "_") if options.keep and not number else scratch
        failed, run = run_case(case, folder, out, options)
        if failed:
            say(f"failed: {failed}")
            return {**result, "failed": failed}
        digests.add(hashlib.sha256((out / "trajectory.tum").read_bytes()).hexdigest())
        runs.append({**summary_of(run), **errors_of(case, run, folder)})
    runs.sort(key=lambda found: found["wall_ms"])
    result |= runs[(len(runs) - 1) // 2]
    result["same_bits"] = len(digests) == 1 if options.runs > 1 else None
    if not options.hard:
        result["limit_ms"] = limit_ms(folder, case.images, result["frames"])
    ate = "no path" if result["ate_m"] is None else f"ATE {result['ate_m']:.4f} m"
    say(f"{result['posed']}/{result['frames']} frames, {ate}, {result['wall_ms']:.0f} ms/frame")
    return result


def limit_ms(folder: Path, patterns: tuple[str, ...], frames: int) -> float:
    """Milliseconds per frame to decode the images and extract ORB in two threads; best of 3."""
    files = [file for pattern in patterns for file in sorted(folder.glob(pattern))]
    own = threading.local()

    def work(file: Path) -> None:
        if not hasattr(own, "orb"):
            own.orb = cv2.ORB_create(LIMIT_FEATURES)
        own.orb.detectAndCompute(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), None)

    with ThreadPoolExecutor(max_workers=2) as pool:
        list(pool.map(work, files[:4]))  # create threads and buffers
        spent_s = []
        for _ in range(3):
            begin = time.perf_counter()
            list(pool.map(work, files))
            spent_s.append(time.perf_counter() - begin)
    return 1e3 * min(spent_s) / frames


def run_case(
    case: Case, folder: Path, out: Path, options: argparse.Namespace, *more: str
) -> tuple[str, VoRun]:
    """`vo run` on a sequence: the reason of a failure, else an empty string; the run.

    Inertial sensors are left out, as the other systems were measured without them, but for cases
    that are about them.
    """
    words = ["--quiet", "--mode", case.mode, "--config", str(options.config), *more]
    words += [] if case.imu else ["--no-imu"]
    words += [part for setting in options.set for part in ("--set", setting)]
    run = run_vo(folder, out, *words, *options_of(folder, options.calibration))
    is_warned = not run.failure and "Warning:" in run.stderr
    return f"a warning: {run.stderr.splitlines()[0]}" if is_warned else run.failure, run


def summary_of(run: VoRun) -> Result:
    """Figures of the run's summary.json, and the wall time of the whole command."""
    summary = run.summary
    return {
        "frames": summary["frames"],
        "posed": summary["tracked"] + summary["inertial_poses"],
        "starting": summary["starting"],
        "lost": summary["lost"],
        "segments": len(summary["segments"]),
        "keyframes": summary["keyframes"],
        "tracking_fps": summary["frames_per_s"],
        "stages": summary["stages"],
        "peak_rss_mb": summary["peak_rss_mb"],
        "wall_ms": 1e3 * run.wall_s / summary["frames"],
    }


def errors_of(case: Case, run: VoRun, folder: Path) -> Result:
    """Errors of the longest segment against the ground truth; None where not available."""
    out, unit = run.output, run.summary["length_unit"]
    is_metric = case.mode == "stereo" or (case.imu and unit == "m")
    align = "se3" if is_metric else "sim3"
    smoothed = _evaluated(out / "trajectory.tum", folder, align)
    causal = _evaluated(out / "causal.tum", folder, align)
    causal_m = None if causal is None else causal.ate.translation.rmse
    if smoothed is None:
        keys = ("ate_m", "ate_percent", "t_rel_percent", "path_m", "rpe_m", "rotation_deg")
        return {**dict.fromkeys((*keys, "scale_percent")), "ate_causal_m": causal_m}
    steps, segments, ate_m = smoothed.rpe_frames, smoothed.segments, smoothed.ate.translation.rmse
    return {
        "ate_m": ate_m,
        "ate_causal_m": causal_m,
        "path_m": smoothed.path_m,
        "ate_percent": 100.0 * ate_m / smoothed.path_m if smoothed.path_m > 0 else None,
        "t_rel_percent": None if segments is None else segments.translation_percent,
        "rpe_m": None if steps is None else steps.translation.rmse,
        "rotation_deg": None if steps is None else steps.rotation.rmse,
        "scale_percent": smoothed.alignment.scale_error_percent,
    }


def _evaluated(estimate: Path, folder: Path, align: str) -> Any:
    from vo.base.errors import VoError
    from vo.outputs.evaluation.evaluation import evaluate
    from vo.outputs.evaluation.inputs import load_inputs

    try:
        inputs = load_inputs(estimate, folder)
        return evaluate(inputs.estimate, inputs.reference, align)
    except VoError:
        return None
