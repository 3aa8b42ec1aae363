"""Kills `vo run` at many moments, while it tracks and while it closes, and counts what is lost.

Every run writes all results and exports. After SIGINT and SIGTERM everything must be complete up to
the last frame, and a run that had tracked all frames must be finished; after SIGKILL every file
must be readable up to a second before. No process may be left. With --full-disk, runs into small
file systems (mounted where that is allowed, else a limit for each file). The exit status is 1 if
anything is lost.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from common import EXPERIMENTS, parser_of, rendered, write_section
from kills_checks import TABLES, Rest, check, processes_with

PAGE = EXPERIMENTS / "stopped-runs.md"
WALK = ["world=room", "motion=handheld", "camera=pinhole", "seconds=6", "scale=0.5"]
SIGNALS = {"SIGINT": 1, "SIGINT twice": 2, "SIGINT 4 times": 4, "SIGTERM": 1, "SIGKILL": 1}
PHASES = ("while tracking", "while closing")
DISKS_KB = (64, 150, 400, 1000, 2500, 6000)
_START_FRACTION = 0.15  # of the moments of a run: before its first frame
_LEFT_S = 10.0  # until the processes of a killed run must have ended
_POLL_S = 0.002


@dataclass
class Count:
    """Counts of one kind of kills."""

    runs: int = 0
    finished: int = 0
    problems: list[str] = field(default_factory=list)


class Bench:
    """Starts and kills runs on one recording."""

    def __init__(self, vo: Path, recording: Path, work: Path) -> None:
        self._vo, self._recording, self._work = vo, recording, work
        self.frames = 0
        self._start(work / "first").wait()  # compiles where necessary
        whole, times = work / "whole", [time.monotonic()]
        process = self._start(whole)
        self._wait_for_frames(process, whole, _START_FRACTION)
        times.append(time.monotonic())
        self._wait_for_closing(process, whole)
        times.append(time.monotonic())
        process.wait()
        times.append(time.monotonic())
        self.started_s, self.tracked_s, self.closed_s = (
            b - a for a, b in zip(times[:-1], times[1:], strict=True)
        )
        rest = check(whole, False, 0.0)
        if process.returncode or rest.problems:
            raise SystemExit(f"error: a run that is not killed fails: {rest.problems}")
        self.frames = rest.frames
        self._frames_per_s = rest.frames / self.tracked_s

    def kill(self, name: str, phase: str, fraction: float) -> tuple[str, Rest]:
        """Kill a run; what happened in a few words, and what is left."""
        folder = self._work / "run"
        shutil.rmtree(folder, ignore_errors=True)
        mark = f"VO_KILLS={uuid.uuid4()}"
        process = self._start(folder, mark)
        if phase == PHASES[0]:
            self._wait_for_frames(process, folder, fraction)
        else:
            self._wait_for_closing(process, folder)
            time.sleep(fraction * self.closed_s)
        number = getattr(signal, name.split()[0])
        for _ in range(SIGNALS[name]):
            process.send_signal(number)
            time.sleep(0.03)
        _, errors = process.communicate(timeout=300)
        rest = check(folder, number == signal.SIGKILL, self._frames_per_s)
        rest.problems += _wrong_end(process.returncode, number, rest.status, errors)
        give_up = time.monotonic() + _LEFT_S
        while left := processes_with(mark):
            if time.monotonic() > give_up:
                rest.problems.append(f"{len(left)} processes are left")
                break
            time.sleep(0.05)
        return f"{name} {phase} at {fraction:.0%}: status {process.returncode}", rest

    def _start(self, folder: Path, mark: str = "VO_KILLS=") -> subprocess.Popen[str]:
        command = [str(self._vo), "run", str(self._recording), "-o", str(folder / "out")]
        command += ["--config", "fast", "--quiet", "--rrd", str(folder / "run.rrd")]
        command += ["--mcap", str(folder / "run.mcap"), "--ply", str(folder / "map.ply")]
        command += ["--colmap", str(folder / "model")]
        name, _, value = mark.partition("=")
        return subprocess.Popen(
            command,
            env={**os.environ, name: value},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def _wait_for_frames(
        self, process: subprocess.Popen[str], folder: Path, fraction: float
    ) -> None:
        """Wait for a part of the run: first of its start, then of its frames."""
        if fraction < _START_FRACTION:
            time.sleep(fraction / _START_FRACTION * self.started_s)
            return
        wanted = (fraction - _START_FRACTION) / (1.0 - _START_FRACTION) * self.frames
        file = folder / "out" / "frames.csv.partial"
        while process.poll() is None and not (folder / "out" / TABLES[0]).exists():
            if file.exists() and file.read_bytes().count(b"\n") > wanted:
                return
            time.sleep(_POLL_S)

    def _wait_for_closing(self, process: subprocess.Popen[str], folder: Path) -> None:
        """Wait until the results have their final names: the exports are finished after that."""
        while process.poll() is None and not (folder / "out" / TABLES[0]).exists():
            time.sleep(_POLL_S)


def main() -> None:
    """Kill, check, print a line for each kind of kill."""
    options = _options()
    with tempfile.TemporaryDirectory(prefix="vo-kills-") as name:
        recording = rendered(options.cache, "kills_walk", "demo", *WALK)
        bench = Bench(options.vo, recording, Path(name))
        print(f"a whole run: {bench.frames} frames, {bench.started_s:.1f} s to start, ", end="")
        print(f"{bench.tracked_s:.1f} s to track, {bench.closed_s:.1f} s to close")
        counts = {(s, p): Count() for s in SIGNALS for p in PHASES if options.only in f"{s} {p}"}
        for (kind, phase), count in counts.items():
            for moment in range(options.moments):
                what, rest = bench.kill(kind, phase, (moment + 0.5) / options.moments)
                count.runs += 1
                count.finished += rest.status == "finished"
                count.problems += [f"{what}: {problem}" for problem in rest.problems]
            print(_line(kind, phase, count), flush=True)
        disks = list(_full_disks(options.vo, recording, Path(name))) if options.full_disk else []
    problems = [p for count in counts.values() for p in count.problems]
    problems += [p for _, found in disks for p in found]
    if options.write:
        _write(counts, disks)
    if problems:
        raise SystemExit(1)


def _options() -> argparse.Namespace:
    parser = parser_of("kills", __doc__, "only", "vo", "cache", "write")
    add = parser.add_argument
    add("--moments", type=int, default=8, metavar="N", help="kills of each kind and phase")
    add("--full-disk", action="store_true", help="also runs into small file systems")
    return parser.parse_args()


def _wrong_end(code: int, number: int, status: str, errors: str) -> list[str]:
    """What is wrong with the exit status and the messages of a stopped run."""
    problems = []
    allowed = {-number} if number == signal.SIGKILL else {128 + number}
    if status == "finished":
        allowed |= {0, -number}  # a signal after everything was done
    if not status:
        allowed.add(-number)  # before the program has begun
    if code not in allowed:
        problems.append(f"exit status {code} of a run that is {status or 'not begun'}")
    if "Traceback" in errors or "Fatal" in errors:
        problems.append("a traceback: " + " / ".join(errors.strip().splitlines()[-12:]))
    return problems


def _full_disks(vo: Path, recording: Path, work: Path) -> Iterator[tuple[str, list[str]]]:
    """Runs on disks of several sizes; what is wrong with each."""
    for size_kb in DISKS_KB:
        place = work / "disk"
        place.mkdir(exist_ok=True)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size_kb}k", "tmpfs", str(place)]
        is_mounted = not subprocess.run(mount, capture_output=True, check=False).returncode
        limit = "" if is_mounted else f"ulimit -f {size_kb // 10}; "
        arguments = f"-o {place}/out --rrd {place}/run.rrd --mcap {place}/run.mcap"
        arguments += f" --ply {place}/map.ply --colmap {place}/model --config fast --quiet"
        command = f"{limit}exec {vo} run {recording} {arguments}"
        try:
            result = subprocess.run(
                ["bash", "-c", command], capture_output=True, text=True, check=False
            )
            problems = _full_disk_problems(result, place)
        finally:
            if is_mounted:
                subprocess.run(["umount", str(place)], check=False)
            else:
                shutil.rmtree(place)
        name = f"{size_kb} kB" + ("" if is_mounted else " (limit of each file)")
        print(f"full disk, {name}: status {result.returncode}; {'; '.join(problems) or 'good'}")
        yield name, problems


def _full_disk_problems(result: subprocess.CompletedProcess[str], place: Path) -> list[str]:
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    if not (place / "out" / "summary.json").is_file():
        return [] if len(errors) == 1 else ["no summary, and no error"]
    rest = check(place, True, 0.0)
    # Exports that have stopped are reported, and need not have all frames.
    problems = [p for p in rest.problems if " frames" not in p or p.startswith("summary")]
    if rest.status == "interrupted":
        problems.append("the summary does not tell the error")
    if len(errors) != (rest.status != "finished"):
        problems.append(f"{len(errors)} lines of errors for status {rest.status}")
    if "Traceback" in result.stderr:
        problems.append("a traceback")
    return problems


def _line(kind: str, phase: str, count: Count) -> str:
    lines = [f"{kind} {phase}: {count.runs} kills, {count.finished} of finished runs, "]
    lines[0] += f"{len(count.problems)} problems"
    return "\n".join(lines + [f"  {problem}" for problem in count.problems])


def _write(counts: dict[tuple[str, str], Count], disks: list[tuple[str, list[str]]]) -> None:
    lines = [
        "| signal | phase | kills | run was finished | something lost |",
        "| --- | --- | ---: | ---: | ---: |",
    ]
    for (kind, phase), count in counts.items():
        lost = len({problem.partition(": ")[0] for problem in count.problems})
        lines.append(f"| {kind} | {phase} | {count.runs} | {count.finished} | {lost} |")
    if disks:
        bad = Counter(bool(problems) for _, problems in disks)
        names = ", ".join(name for name, _ in disks)
        lines += ["", f"Full disks ({names}): {len(disks)} runs, {bad[True]} with a problem."]
    write_section(PAGE, "kills", "\n".join(lines))


if __name__ == "__main__":
    main()
