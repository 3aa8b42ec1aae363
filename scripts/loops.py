"""Runs `vo run` with and without --loops on recordings that come back, and checks every loop.

The recordings are rendered once, into --cache. For each keyframe that sees a place again (within
2 m and 30° of a pose at least ten seconds before) it is counted whether a loop was closed within a
second of it. A loop is false where the true distance of its two frames is not the one in the path
to 1 m; in mono, the scale of the path is that near the earlier frame. The exit status is 1 if a
loop is false.

With --clean the recordings are those of ../shared/data and of the synthetic suite, most of which
never come back: no loop may be false, results without a loop must have the same bytes, and the
ratio of CPU times is the cost. Inertial sensors are not used. Recordings given as arguments are
used instead of either set. With --write the rows measured replace those of the same recordings.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from common import (
    EXPERIMENTS,
    ROOT,
    VO,
    parser_of,
    real_recordings,
    rendered,
    run_timed,
    run_vo,
    suite,
    write_section,
)

from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.types import Floats
from vo.recordings.formats.trajectory import read_trajectory

PAGE = EXPERIMENTS / "loop-closure.md"
SMALL = ("scale=0.5", "motion=loop", "format=euroc")
COURSES = {
    "room, three laps": ("world=room", "camera=pinhole", "seconds=40", "fps=10", "seed=1"),
    "room, forward and reverse": (
        *("world=room", "camera=pinhole", "seconds=50", "fps=10", "seed=1"),
        "laps=[forward,reverse,forward]",
    ),
    "room, kidnapped twice": (
        *("world=room", "camera=pinhole", "seconds=40", "fps=10", "seed=1"),
        "effects.kidnap=2",
    ),
    "office corridor, two laps": (
        *("world=corridor", "camera=euroc", "seconds=180", "fps=5", "seed=3"),
        "laps=[forward,forward]",
    ),
    "warehouse aisles, two laps": (
        *("world=warehouse", "camera=pinhole", "seconds=120", "fps=4", "seed=4"),
        *("scale=0.4", "speed=2", "laps=[forward,forward]"),
    ),
    "street block, forward and reverse": (
        *("world=street", "camera=kitti", "seconds=205", "fps=6", "seed=5"),
        *("scale=0.4", "laps=[forward,reverse,forward]"),
    ),
}
COURSE_COLUMNS = (
    *("recording", "cameras", "revisits", "recall", "loops", "false", "farthest, m"),
    *("ATE without, m", "with, m", "worlds", "CPU time"),
)
CLEAN_COLUMNS = (
    *("recording", "cameras", "frames", "keyframes", "revisits", "loops", "false"),
    *("ATE without, m", "with, m", "CPU time"),
)
_TEXT_COLUMNS = 2
# Runs the command line, and prints the CPU seconds of the threads in what memory adds to a run.
_COST_PROGRAM = """
import functools, sys, time
from vo.cli.entry import main
from vo.engine.memory.memory import Memory
from vo.engine.memory.recognition import Recogniser
spent = []
def measured(function):
    @functools.wraps(function)
    def timed(*arguments, **named):
        begin = time.thread_time()
        try:
            return function(*arguments, **named)
        finally:
            spent.append(time.thread_time() - begin)
    return timed
Memory.add, Memory.begin_frame = measured(Memory.add), measured(Memory.begin_frame)
Recogniser._recognise = measured(Recogniser._recognise)
try:
    main()
finally:
    print(sum(spent))
"""
_NEAR_M, _NEAR_DEG = 2.0, 30.0
_MAX_ERROR_M = 1.0  # of the distance of the frames of a loop
_NEAR_FRAMES = 15  # on each side, for the scale of a path
_AGAIN_S, _FOUND_S = 10.0, 1.0
_FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")


@dataclass(frozen=True)
class Run:
    """What `vo run` gave: its summary, ATE in metres, CPU seconds, and result files."""

    summary: dict[str, Any]
    ate_m: float | None
    cpu_s: float
    files: tuple[bytes, ...]
    frame_stamps: dict[int, int]
    positions: dict[int, Floats]
    keyframes: list[int]


def main() -> None:
    """Render, run, check, print, and perhaps write the table."""
    parser = parser_of("loops", __doc__, "only", "data", "write")
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--clean", action="store_true", help="recordings without loops")
    parser.add_argument("--cost", action="store_true", help="only the share of the CPU time")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "loops")
    parser.add_argument("--modes", default="stereo,mono")
    parser.add_argument("--end", type=int, metavar="N", help="stop before this frame")
    arguments = parser.parse_args()
    columns = CLEAN_COLUMNS if arguments.clean else COURSE_COLUMNS
    false = 0
    for name, path in _recordings(arguments):
        for mode in arguments.modes.split(","):
            if "mono" in name and mode == "stereo":
                continue
            options = _options(arguments, mode)
            if arguments.cost:
                print(f"{name}, {mode}: {100 * _cost(path, options[1]):.1f} %", flush=True)
                continue
            result = _measure(name, path, options)
            false += int(result["false"])
            row = [result[column] for column in columns]
            print("| " + " | ".join(row) + " |", flush=True)
            if arguments.write:
                _write(row, columns, "clean" if arguments.clean else "loops")
    sys.exit(1 if false else 0)


def _options(arguments: argparse.Namespace, mode: str) -> tuple[list[str], list[str]]:
    """Options of `vo run` without and with loops."""
    both = ["--mode", mode, "--no-imu", "-q"]
    both += [] if arguments.end is None else ["--end", str(arguments.end)]
    return [*both, "--no-loops"], [*both, "--loops"]


def _recordings(arguments: argparse.Namespace) -> list[tuple[str, Path]]:
    if arguments.recordings:
        return [(path.name, path) for path in arguments.recordings]
    if arguments.clean:
        real = [path for path in real_recordings(arguments.data) if _truth_files(path)]
        makes = {path.name: partial(Path, path) for path in real} | suite(arguments.cache)
    else:
        makes = {
            name: partial(rendered, arguments.cache, re.sub(r"\W+", "_", name), None, *SMALL, *own)
            for name, own in COURSES.items()
        }
    return [(name, make()) for name, make in makes.items() if arguments.only in name]


def _measure(name: str, path: Path, options: tuple[list[str], list[str]]) -> dict[str, str]:
    """The figures of a recording, by column."""
    with TemporaryDirectory() as folder:
        without = _run(path, Path(folder, "without"), options[0])
        loops = _run(path, Path(folder, "with"), options[1])
    found = loops.summary["loops"]
    truth = read_truth(path)
    frames = {f: pose_at(truth, s) for f, s in loops.frame_stamps.items()}
    apart = [_apart_m(frames, loop) for loop in found]
    false = sum(
        not abs(distance - _in_path_m(loops, frames, loop)) < _MAX_ERROR_M
        for distance, loop in zip(apart, found, strict=True)
    )
    revisits, recalled = _recall(loops, frames, found)
    same = without.files == loops.files
    return {
        "recording": name,
        "cameras": loops.summary["mode"],
        "frames": str(loops.summary["frames"]),
        "keyframes": str(len(loops.keyframes)),
        "revisits": str(revisits),
        "recall": f"{recalled / revisits:.2f}" if revisits else "–",
        "loops": str(len(found)),
        "false": str(false),
        "farthest, m": f"{max(apart):.1f}" if apart else "–",
        "ATE without, m": _number(without.ate_m),
        "with, m": "same bytes" if same else _number(loops.ate_m),
        "worlds": f"{len(without.summary['segments'])} → {len(loops.summary['segments'])}",
        "CPU time": f"{loops.cpu_s / without.cpu_s:.2f}",
    }


def _run(path: Path, output: Path, options: list[str]) -> Run:
    run = run_vo(path, output, *options)
    if run.failure:
        raise SystemExit(f"error: vo run {path} failed: {run.failure}")
    rows = [line.split(",") for line in (output / "poses.csv").read_text().splitlines()[1:]]
    return Run(
        run.summary,
        _ate_m(output, path),
        run.cpu_s,
        tuple((output / name).read_bytes() for name in _FILES),
        {int(row[0]): int(row[1]) for row in rows},
        {int(row[0]): np.array(row[5:8], dtype=np.float64) for row in rows},
        [int(row[0]) for row in rows if row[3] == "1"],
    )


def _cost(path: Path, options: list[str]) -> float:
    """CPU time of memory relative to that of the rest of a run; exact also on a busy machine."""
    with TemporaryDirectory() as folder:
        program = [sys.executable, "-P", "-c", _COST_PROGRAM]
        run = run_timed([*program, "run", str(path), "-o", folder, *options], Path(folder))
    spent = float(run.stdout.split()[-1])
    return spent / (run.cpu_s - spent)


def _ate_m(output: Path, path: Path) -> float | None:
    result = run_timed([str(VO), "eval", str(output), str(path), "--json"], output)
    if result.status:
        return None
    return float(json.loads(result.stdout)["ate"]["translation_m"]["rmse"])


def _truth_files(path: Path) -> list[Path]:
    names = ("groundtruth.tum", "groundtruth.txt", "poses_cam0.tum", "poses.txt")
    return [path / name for name in names if (path / name).is_file()]


def read_truth(path: Path) -> dict[int, Floats]:
    """True poses of a recording, by stamp in nanoseconds."""
    truth = read_trajectory(_truth_files(path)[0])
    return {int(s): p for s, p in zip(truth.stamps_ns, truth.world_from_cam, strict=True)}


def pose_at(poses: dict[int, Floats], stamp_ns: int) -> Floats | None:
    """The true pose of a stamp, to 2 ms: text has no more digits than microseconds."""
    if stamp_ns in poses:
        return poses[stamp_ns]
    nearest = min(poses, key=lambda each: abs(each - stamp_ns))
    return poses[nearest] if abs(nearest - stamp_ns) < 2_000_000 else None


def _apart_m(frames: dict[int, Floats | None], loop: dict[str, Any]) -> float:
    first, second = frames.get(loop["earlier_frame"]), frames.get(loop["frame"])
    if first is None or second is None:
        return float("nan")
    return float(np.linalg.norm(first[:3, 3] - second[:3, 3]))


def _in_path_m(run: Run, frames: dict[int, Floats | None], loop: dict[str, Any]) -> float:
    """Distance of the two frames of a loop in the path, NaN if unknown."""
    first, second = (run.positions.get(loop[key]) for key in ("earlier_frame", "frame"))
    if first is None or second is None:
        return float("nan")
    scale = 1.0
    if run.summary["mode"] == "mono":
        near = [f for f in run.positions if abs(f - loop["earlier_frame"]) <= _NEAR_FRAMES]
        known = [(frames[f], run.positions[f]) for f in near if frames[f] is not None]
        true = np.array([pose[:3, 3] for pose, _ in known if pose is not None])
        path = np.array([position for _, position in known])
        scale = float(np.linalg.norm(true - true.mean(0)) / np.linalg.norm(path - path.mean(0)))
    return scale * float(np.linalg.norm(first - second))


def _recall(
    run: Run, frames: dict[int, Floats | None], found: list[dict[str, Any]]
) -> tuple[int, int]:
    """Keyframes that see a place again, and those of them near which a loop was closed."""
    placed = [(f, frames[f], 1e-9 * run.frame_stamps[f]) for f in sorted(run.frame_stamps)]
    known = [(pose, at) for _, pose, at in placed if pose is not None]
    if not known:
        return 0, 0
    positions = np.stack([pose[:3, 3] for pose, _ in known])
    times = np.array([at for _, at in known])
    closed = np.array([1e-9 * run.frame_stamps[loop["frame"]] for loop in found])
    revisits = recalled = 0
    for number in run.keyframes:
        pose, now = frames[number], 1e-9 * run.frame_stamps[number]
        if pose is None:
            continue
        near = np.linalg.norm(positions - pose[:3, 3], axis=1) < _NEAR_M
        rows = np.flatnonzero(near & (times < now - _AGAIN_S))
        limit = np.radians(_NEAR_DEG)
        if any(rotation_angle((inverse(known[r][0]) @ pose)[:3, :3]) < limit for r in rows[::5]):
            revisits += 1
            recalled += bool(len(closed)) and bool((np.abs(closed - now) < _FOUND_S).any())
    return revisits, recalled


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4f}"


def _write(row: list[str], columns: tuple[str, ...], section: str) -> None:
    """Write a row into a table of the page, in place of that of the same recording and cameras."""
    text = PAGE.read_text()
    begin, end = f"<!-- {section}: begin -->", f"<!-- {section}: end -->"
    known = re.findall(r"^\| (.*) \|$", text.split(begin)[1].split(end)[0], flags=re.MULTILINE)
    rows = [line.split(" | ") for line in known][2:]
    rows = [row if old[:_TEXT_COLUMNS] == row[:_TEXT_COLUMNS] else old for old in rows]
    if row not in rows:
        rows.append(row)
    numbers = len(columns) - _TEXT_COLUMNS
    rule = ["---"] * _TEXT_COLUMNS + ["---:"] * numbers
    lines = ["| " + " | ".join(each) + " |" for each in (columns, rule, *rows)]
    write_section(PAGE, section, "\n".join(lines))


if __name__ == "__main__":
    main()
