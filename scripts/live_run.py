"""Runs the odometry on a live RTSP stream, and checks memory, dropped images and delays.

The camera is a server in a process of its own, which sends a synthetic stereo walk, forwards and
backwards, at 30 frames/s. For a sixth of the time each frame takes the consumer 0.2 s longer. Then
images must be dropped and counted, memory must not grow, and poses must be in time afterwards.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from common import parser_of, rendered
from live_servers import LiveServer

from vo.base.config import load_config
from vo.base.types import Estimate
from vo.outputs.results.environment import peak_rss_mb
from vo.outputs.results.summary import Summary
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

WALK = ["seconds=14", "scale=0.5", "effects.exposure=0"]
RATE_HZ = 30.0
SLOW_S = 0.2  # what each frame takes longer while the consumer is slow
MAX_GROWTH = 1.1  # of memory, from before the slow time to the end
MAX_DELAY_S = 0.5  # 95th percentile, before and after the slow time


class Sample(NamedTuple):
    """One frame: seconds since the first, delay of its pose, images dropped so far, memory."""

    at_s: float
    delay_ms: float
    dropped: int
    memory_mb: float


class Phase(NamedTuple):
    """Part of the run."""

    name: str
    samples: Sequence[Sample]
    dropped: int

    def line(self) -> str:
        """A row of the table."""
        delays = [sample.delay_ms for sample in self.samples]
        median, p95, largest = np.percentile(delays, (50, 95, 100))
        memory = self.samples[-1].memory_mb
        return (
            f"| {self.name} | {len(delays)} | {self.dropped} | {median:.0f} | {p95:.0f} | "
            f"{largest:.0f} | {memory:.0f} |"
        )


class Consumer:
    """Observes a run, and is slow between two times."""

    def __init__(self, slow: tuple[float, float]) -> None:
        self.samples: list[Sample] = []
        self._slow = slow
        self._begun: float | None = None

    def begin(self, name: str, total: int) -> None:
        """Do nothing."""

    def step(self, done: int, estimate: Estimate) -> None:
        """Note a frame, and perhaps wait."""
        now = time.time()
        if self._begun is None:
            self._begun = now
        at_s = now - self._begun
        delay_ms = 1e3 * now - 1e-6 * estimate.stamp_ns
        self.samples.append(Sample(at_s, delay_ms, estimate.dropped, _memory_mb()))
        if self._slow[0] <= at_s < self._slow[1]:
            time.sleep(SLOW_S)

    def finish(self) -> None:
        """Do nothing."""

    def phases(self) -> list[Phase]:
        """The frames before, during and after the slow time."""
        limits = (0.0, *self._slow, float("inf"))
        phases, dropped = [], 0
        for number, name in enumerate(("before", "slow", "after")):
            # Images that the last slow frame has cost are counted with the first one after it.
            chosen = [s for s in self.samples if limits[number] <= s.at_s < limits[number + 1]]
            if chosen:
                phases.append(Phase(name, chosen, chosen[-1].dropped - dropped))
                dropped = chosen[-1].dropped
        return phases


def main() -> None:
    """Serve, run, judge; the exit status is 1 if a target is missed."""
    options = _options()
    walk = rendered(options.cache, "endurance", "demo", *WALK)
    if options.serve:
        _serve(walk)
    with tempfile.TemporaryDirectory(prefix="vo-live-") as name, _server(options.cache) as url:
        work = Path(name)
        write_calibration(work / "camera.yaml", open_source(walk).rig)
        slow = (options.seconds / 3, options.seconds / 2)
        consumer = Consumer(slow)
        summary = run(
            url,
            work / "run",
            config=load_config(options.config),
            calibration=work / "camera.yaml",
            side_by_side=True,
            duration_s=options.seconds,
            progress=consumer,
            record=work / "log.mcap" if options.record else None,
        )
    raise SystemExit(_judge(consumer.phases(), summary))


def judged(phases: Sequence[Phase], dropped: int, warnings: Sequence[str]) -> list[str]:
    """What is wrong with a run; empty if nothing is."""
    before, slow, after = phases
    problems = []
    growth = after.samples[-1].memory_mb / before.samples[-1].memory_mb
    if growth > MAX_GROWTH:
        problems.append(f"memory has grown by {growth - 1:.0%}")
    if not slow.dropped:
        problems.append("no image was dropped while the consumer was slow")
    if dropped and not any("dropped" in warning for warning in warnings):
        problems.append("dropped images were not reported")
    for phase in (before, after):
        p95_s = 1e-3 * np.percentile([sample.delay_ms for sample in phase.samples], 95)
        if p95_s > MAX_DELAY_S:
            problems.append(f"{phase.name}: poses come {p95_s:.1f} s late")
    return problems


def _judge(phases: Sequence[Phase], summary: Summary) -> int:
    print("| consumer | frames | dropped | delay, median | 95 % | max, ms | memory, MiB |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for phase in phases:
        print(phase.line())
    assert summary.live is not None
    print(f"result: {summary.verdict.word}, {summary.tracked} of {summary.frames} frames tracked")
    for warning in summary.warnings:
        print(f"warning: {warning}")
    problems = judged(phases, summary.live.dropped, summary.warnings)
    for problem in problems:
        print(f"FAILED: {problem}")
    return int(bool(problems))


def _options() -> argparse.Namespace:
    parser = parser_of("live", __doc__, "cache", "config")
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--record", action="store_true", help="also record the frames")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


@contextmanager
def _server(cache: Path) -> Iterator[str]:
    command = [sys.executable, __file__, "--serve", "--cache", str(cache)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def _serve(walk: Path) -> None:
    """Send the walk until the process is ended."""
    sides = [sorted((walk / "mav0" / camera / "data").glob("*.png")) for camera in ("cam0", "cam1")]
    pairs = list(zip(*sides, strict=True))
    images = [
        np.hstack([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pair])
        for pair in chain(pairs, pairs[-2:0:-1])
    ]
    print(LiveServer("rtsp", images, RATE_HZ).url, flush=True)
    while True:
        time.sleep(1.0)


def _memory_mb() -> float:
    """Resident memory of this process in MiB; its peak where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    except OSError:
        return peak_rss_mb()
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    main()
