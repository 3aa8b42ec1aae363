"""Measures the latency of `vo.Odometry.track`, with frames at the rate of the camera.

Each frame is given when its camera would have taken it, or, if the odometry is late, as soon as it
is ready; the latency is the time from the call until the pose is known, without the decoding of the
images. A recording that is too slow for `--rate` is given faster.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

import vo

PRESETS = ("default", "fast", "accurate")
WARM_UP = 5  # frames that are not counted: the first ones create the map and load code
DEFAULT_RATE = 30.0
COLUMNS = ["recording", "mode", "preset", "frames", "median", "p95", "p99", "maximum", "late"]


class Latency(NamedTuple):
    """Latencies of one run, in milliseconds, and the number of frames given late."""

    frames: int
    median: float
    p95: float
    p99: float
    maximum: float
    late: int


def main() -> None:
    """Measure every recording with every preset, and print a Markdown table."""
    options = _options()
    print("| " + " | ".join(COLUMNS) + " |")
    print("| --- | --- | --- |" + " ---: |" * (len(COLUMNS) - 3), flush=True)
    for path in options.recordings:
        for preset in options.preset or PRESETS:
            latency = measure(path, options.mode, preset, options.rate)
            figures = [f"{value:.1f}" for value in latency[1:5]]
            row = [path.name, options.mode, preset, str(latency.frames), *figures]
            print("| " + " | ".join([*row, str(latency.late)]) + " |", flush=True)


def measure(
    path: Path, mode: Literal["auto", "mono", "stereo"], preset: str, rate: float
) -> Latency:
    """Latency over a recording whose images were decoded beforehand."""
    recording = vo.open(path, mode=mode)
    frames = list(recording.frames())
    taken, late = [], 0
    with vo.Odometry(recording.rig, preset) as odometry:
        due = time.perf_counter()
        for frame in frames:
            due += 1.0 / rate
            wait = due - time.perf_counter()
            if wait > 0:
                time.sleep(wait)
            else:
                late += 1
                due -= wait
            begin = time.perf_counter()
            odometry.track(frame.stamp_ns, frame.image0, frame.image1, frame.depth)
            taken.append(1e3 * (time.perf_counter() - begin))
    measured = np.array(taken[WARM_UP:])
    median, p95, p99 = np.percentile(measured, [50, 95, 99]).tolist()
    return Latency(len(measured), median, p95, p99, float(measured.max()), late)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/latency", description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path, help="recordings in any format")
    parser.add_argument("--mode", default="auto", help="mono ignores the right camera")
    parser.add_argument("--preset", action="append", help="of these presets; repeatable")
    parser.add_argument("--rate", type=float, default=DEFAULT_RATE, help="frames per second")
    options = parser.parse_args()
    if not options.rate > 0:
        parser.error("--rate must be above 0")
    return options


if __name__ == "__main__":
    sys.exit(main())
