"""Runs `vo run` for a long time and checks that memory and speed stay constant.

The recording is a synthetic walk, rendered once and repeated forwards and backwards, so that the
motion never jumps. Speed is in CPU time, so that other work on the machine does not matter.

With --laps it is laps through a room, whose end meets their beginning, each frame with noise of its
own, and loops are closed (`endurance_laps.py`): what is stored must stay bounded, too.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import chain, cycle, islice
from pathlib import Path

import endurance_laps
from common import VO, parser_of, rendered

WALK = ["seconds=14", "scale=0.5", "effects.exposure=0"]
POLL_S = 0.5
EARLY_FRAMES = 2000  # the reference for the end
MAX_MEMORY_RATIO, MIN_SPEED_RATIO = 1.1, 0.9


@dataclass(frozen=True)
class Sample:
    """State of the run at one time: frames done, memory of its processes in MiB, CPU seconds."""

    frames: int
    memory_mb: float
    cpu_s: float


def main() -> None:
    """Render, repeat, run, sample, judge; the exit status is 1 if a target is missed."""
    options = _options()
    with tempfile.TemporaryDirectory(prefix="vo-endurance-") as name:
        work = Path(name)
        samples = _run_and_sample(_command(options, work), work / "run")
        summary = json.loads((work / "run" / "summary.json").read_text(encoding="utf-8"))
        if options.laps:
            _print_memory(work / "memory.csv", samples, options.frames)
    _judge(samples, summary, options.frames)


def _command(options: argparse.Namespace, work: Path) -> list[str | Path]:
    """The command that is measured, with results in the folder `run`."""
    output = work / "run"
    if options.laps:
        program = Path(__file__).with_name("endurance_laps.py")
        laps = rendered(options.cache, "endurance_laps", None, *endurance_laps.LAPS)
        request = (output, str(options.frames), options.config, options.mode, laps)
        return [sys.executable, program, *request]
    walk = rendered(options.cache, "endurance", "demo", *WALK)
    recording = _repeated(walk, work / "recording", options.frames)
    choice = ["--config", options.config, "--mode", options.mode]
    return [VO, "run", recording, "-o", output, "--quiet", *choice]


def _options() -> argparse.Namespace:
    parser = parser_of("endurance", __doc__, "cache", "config")
    parser.set_defaults(config="fast")
    parser.add_argument("--frames", type=int, default=20000)
    parser.add_argument("--mode", default="auto", help="mono ignores the right camera")
    parser.add_argument("--laps", action="store_true", help="laps through a room, with loops")
    options = parser.parse_args()
    if options.frames < 2 * EARLY_FRAMES:
        parser.error(f"--frames must be {2 * EARLY_FRAMES} or more")
    return options


def _repeated(walk: Path, folder: Path, frames: int) -> Path:
    """A recording with this number of frames, whose images are links to those of the walk."""
    folder.mkdir()
    shutil.copy(walk / "calibration.yaml", folder)
    for side, camera in (("left", "cam0"), ("right", "cam1")):
        images = sorted((walk / "mav0" / camera / "data").glob("*.png"))
        there_and_back = cycle(chain(images, images[-2:0:-1]))
        (folder / side).mkdir()
        for number, image in enumerate(islice(there_and_back, frames)):
            (folder / side / f"{number:06d}.png").symlink_to(image.resolve())
    times = "".join(f"{number / 15:.9f}\n" for number in range(frames))
    (folder / "times.txt").write_text(times, encoding="utf-8")
    return folder


def _run_and_sample(command: list[str | Path], output: Path) -> list[Sample]:
    samples: list[Sample] = []
    lines = _LineCounter(output / "frames.csv.partial")
    with subprocess.Popen(list(map(str, command))) as process:
        while process.poll() is None:
            time.sleep(POLL_S)
            try:
                memory_mb, cpu_s = _used(process.pid)
            except OSError:  # a thread or the process has ended meanwhile
                continue
            samples.append(Sample(lines.count(), memory_mb, cpu_s))
    if process.returncode:
        raise SystemExit(f"error: vo run ended with status {process.returncode}")
    return samples


class _LineCounter:
    """Counts the lines of a growing file, and reads only its new part."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = 0
        self._count = 0

    def count(self) -> int:
        try:
            with self._path.open("rb") as file:
                file.seek(self._read)
                new = file.read()
        except FileNotFoundError:  # not created yet, or renamed at the end
            return self._count
        self._read += len(new)
        self._count += new.count(b"\n")
        return self._count


def _used(pid: int) -> tuple[float, float]:
    """MiB of resident memory and CPU seconds of a process and its children."""
    memory_mb, cpu_s = 0.0, 0.0
    for each in (pid, *_children(pid)):
        resident = int(Path(f"/proc/{each}/statm").read_text().split()[1])
        memory_mb += resident * os.sysconf("SC_PAGE_SIZE") / 2**20
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        # Includes the time of ended children, so that a closed process still counts.
        cpu_s += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return memory_mb, cpu_s


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def _judge(samples: list[Sample], summary: dict[str, object], frames: int) -> None:
    early, late = _speed(samples, 0, EARLY_FRAMES), _speed(samples, frames - EARLY_FRAMES, frames)
    at_early, at_end = _memory(samples, EARLY_FRAMES), _memory(samples, frames)
    print(f"frames tracked      {summary['tracked']} of {frames}")
    print(f"memory              {at_early:.1f} MiB after {EARLY_FRAMES} frames, ", end="")
    print(f"{at_end:.1f} MiB at the end: {at_end / at_early:.3f} (at most {MAX_MEMORY_RATIO})")
    print(f"frames per CPU second  {early:.2f} in the first {EARLY_FRAMES} frames, ", end="")
    print(f"{late:.2f} in the last: {late / early:.3f} (at least {MIN_SPEED_RATIO})")
    if at_end > MAX_MEMORY_RATIO * at_early or late < MIN_SPEED_RATIO * early:
        raise SystemExit(1)


def _print_memory(file: Path, samples: list[Sample], frames: int) -> None:
    """What memory stores and costs, in each part of the run."""
    rows = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines()[1:]]
    print(" frames  stored  in database  loops  search, ms  graph poses  MiB  frames per CPU s")
    for first in range(0, frames, EARLY_FRAMES):
        last = first + EARLY_FRAMES
        here = [row for row in rows if first <= int(row[0]) < last]
        search_ms = 1000.0 * sum(float(row[4]) for row in here) / max(len(here), 1)
        stored, in_database, loops, poses = (here[-1][n] for n in (1, 2, 3, 5))
        print(
            f"{last:7} {stored:>7} {in_database:>12} {loops:>6} {search_ms:11.1f} {poses:>12} "
            f"{_memory(samples, last):4.0f} {_speed(samples, first, last):17.1f}"
        )


def _memory(samples: list[Sample], frames: int) -> float:
    """Peak memory in the last tenth of the frames up to this one."""
    return max(s.memory_mb for s in samples if 0.9 * frames < s.frames <= frames)


def _speed(samples: list[Sample], first: int, last: int) -> float:
    """Frames per CPU second from about frame `first` to about frame `last`."""
    inside = [s for s in samples if first < s.frames <= last]
    return (inside[-1].frames - inside[0].frames) / (inside[-1].cpu_s - inside[0].cpu_s)


if __name__ == "__main__":
    main()
