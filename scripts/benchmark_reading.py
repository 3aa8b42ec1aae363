"""Speed of reading and of rendering recordings, and cost of recording a run."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from common import VO, VoRun, rendered, run_timed, run_vo

FRAMES = 100
RUNS = 5
KINDS = {
    "EuRoC folder, PNG": ("euroc", "png"),
    "EuRoC folder, JPEG": ("euroc", "jpeg"),
    "MCAP (Foxglove), raw": ("mcap", "raw"),
    "MCAP (Foxglove), PNG": ("mcap", "png"),
    "MCAP (Foxglove), JPEG": ("mcap", "jpeg"),
    "MCAP (ROS 2), raw": ("mcap-ros2", "raw"),
    "MCAP (ROS 2), PNG": ("mcap-ros2", "png"),
}

# A separate process, so that nothing of the file is in its memory before.
_PROGRAM = """
import json, sys, time
from vo.recordings.sources.registry import open_source
open_source(sys.argv[1])  # imports
wall, cpu = time.perf_counter(), time.process_time()
count = sum(1 for _ in open_source(sys.argv[1]).frames())
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
print(json.dumps({"fps": count / wall, "cpu_ms": 1e3 * cpu / count, "frames": count}))
"""


MOTIONS = {
    "room": "handheld",
    "corridor": "robot",
    "street": "car",
    "warehouse": "robot",
    "terrain": "drone",
}
RENDERED_FRAMES = 40

# One process per world, so that its peak memory is that of this world.
_RENDERING = """
import json, resource, sys, tempfile, time
from pathlib import Path
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.sequence import make_sequence
world, motion, frames = sys.argv[1], sys.argv[2], int(sys.argv[3])
recipe = load_recipe(None, [f"world={world}", f"motion={motion}", f"seconds={frames / 20}"])
times = []
with tempfile.TemporaryDirectory() as folder:
    for _ in range(2):  # the first one may compile
        begin = time.perf_counter()
        make_plan(recipe)
        build_s = time.perf_counter() - begin
    stamp = lambda *_: times.append(time.perf_counter())
    make_sequence(Path(folder) / "made", recipe, on_frame=stamp)
peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
fps = (len(times) - 6) / (times[-1] - times[5])
result = {"world": world, "motion": motion, "build_s": build_s, "fps": fps}
print(json.dumps({**result, "peak_mb": peak_mb}))
"""


def measure_reading(cache: Path, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Stereo frames per second of reading alone, and CPU time per frame, at 752 x 480."""
    original = rendered(cache, "reading", None, f"seconds={FRAMES / 20}")
    results = []
    with tempfile.TemporaryDirectory(prefix="vo-reading-") as folder:
        for name, (layout, codec) in KINDS.items():
            made = Path(folder) / (f"{layout}-{codec}" + (".mcap" if "mcap" in layout else ""))
            command = [str(VO), "convert", str(original), str(made), "--to", layout, "--quiet"]
            _checked(run_timed([*command, "--codec", codec], made))
            runs = [_read(made) for _ in range(RUNS)]
            best = sorted(runs, key=lambda run: run["fps"])[RUNS // 2]
            size = sum(p.stat().st_size for p in [made, *made.rglob("*")] if p.is_file())
            results.append({"name": name, **best, "mb": size / 1e6})
            say(f"{name}: {best['fps']:.0f} stereo frames/s")
    return results


def measure_recording(sequence: Path, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Wall time per frame of `vo run` without and with an .rrd, and the file size per frame."""
    results = []
    with tempfile.TemporaryDirectory(prefix="vo-recording-") as name:
        rrd = Path(name) / "run.rrd"
        variants = {"no recording": []} | {
            f"--rrd-images {images}": ["--rrd", str(rrd), "--rrd-images", images]
            for images in ("none", "half", "full")
        }
        summaries: dict[str, list[dict[str, Any]]] = {each: [] for each in variants}
        for _ in range(RUNS):  # in turn, so that a slow minute affects all variants
            for each, more in variants.items():
                run = _checked(run_vo(sequence, Path(name) / "out", "--quiet", *more))
                size = rrd.stat().st_size if more else 0
                summaries[each].append({**run.summary, "size": size})
        for each, runs in summaries.items():
            frames = runs[0]["frames"]
            wall_ms = 1e3 * median(run["wall_s"] for run in runs) / frames
            kb = runs[0]["size"] / frames / 1e3
            results.append({"sequence": sequence.name, "name": each, "wall_ms": wall_ms, "kb": kb})
            say(f"{sequence.name}, {each}: {wall_ms:.1f} ms/frame, {kb:.0f} kB/frame")
    return results


def measure_generator(say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Seconds to build each world, stereo frames per second at 752 x 480, and peak memory."""
    results = []
    for world, motion in MOTIONS.items():
        command = [sys.executable, "-P", "-c", _RENDERING, world, motion, str(RENDERED_FRAMES)]
        results.append(json.loads(_checked(run_timed(command, Path())).stdout))
        say(f"{world}: {results[-1]['fps']:.1f} stereo frames/s")
    return results


def _read(recording: Path) -> dict[str, Any]:
    command = [sys.executable, "-P", "-c", _PROGRAM, str(recording)]
    result: dict[str, Any] = json.loads(_checked(run_timed(command, recording)).stdout)
    return result


def _checked(run: VoRun) -> VoRun:
    if run.failure:
        raise SystemExit(f"error: {run.failure}")
    return run
