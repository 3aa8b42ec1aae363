"""Runs recordings with and without each addition, and names what makes a path worse.

An addition may help, never harm: nowhere may the error of a path be more than 1.1 times that
without it plus 1 mm, unless the result says so: it is not to be trusted, or has another warning.
An example:

  scripts/harm ../shared/data/kitti06_stereo_000-050 out/street --write
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import EXPERIMENTS, parser_of, write_section
from robustness_clips import true_poses
from robustness_run import errors

import vo

PAGE = EXPERIMENTS / "harm.md"
MAX_RATIO, MAX_MORE_M = 1.1, 0.001


class Addition(NamedTuple):
    """The setting that leaves an addition out, and the modes in which it can matter."""

    name: str
    without: str
    modes: tuple[str, ...] = ("stereo", "mono")


ADDITIONS = (
    Addition("inertial sensor", "inertial.enabled=false"),
    Addition("loops", "memory.loops=false"),
    Addition("correction of rows", "stereo.row_correction=false", ("stereo",)),
    Addition("correction of disparities", "refinement.disparity_correction=false", ("stereo",)),
    Addition("correction of the lens", "refinement.lens_correction=false"),
    Addition("rescue by learned features", "features.rescue=none"),
)


class Run(NamedTuple):
    """Error of a path in metres, None without one, and what the run says."""

    ate_m: float | None
    is_trusted: bool
    warnings: tuple[str, ...]


def main() -> None:
    """Print the table; with `--write`, into its page too."""
    parser = parser_of("harm", __doc__, "write")
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--end", type=int, help="stop before this frame")
    options = parser.parse_args()
    lines = [
        "| recording | addition | with, m | without, m | |",
        "| --- | --- | ---: | ---: | --- |",
    ]
    for recording in options.recordings:
        for line in rows(recording, options.end):
            lines.append(line)
            print(line, flush=True)
    if options.write:
        write_section(PAGE, "harm", "\n".join(lines))
    sys.exit(any("**harm**" in line for line in lines))


def rows(recording: Path, end: int | None = None) -> list[str]:
    """A row for each mode and addition of a recording with ground truth."""
    stream = vo.open(recording)
    found = []
    for mode in ("stereo", "mono") if stream.rig.is_stereo else ("mono",):
        complete = measure(recording, mode, (), end)
        for addition in ADDITIONS:
            if mode in addition.modes:
                without = measure(recording, mode, (addition.without,), end)
                figures = [_figure(complete.ate_m), _figure(without.ate_m)]
                cells = [f"{recording.name}, {mode}", addition.name, *figures]
                found.append(f"| {' | '.join([*cells, judge(complete, without)])} |")
    return found


def measure(recording: Path, mode: str, overrides: tuple[str, ...], end: int | None) -> Run:
    """Run on a recording with these settings."""
    stream = vo.open(recording, mode="mono")
    if stream.ground_truth is None:
        raise SystemExit(f"error: {recording} has no ground truth")
    truth = true_poses(stream.ground_truth, np.asarray(stream.stamps_ns))
    with tempfile.TemporaryDirectory() as folder:
        vo.run(recording, folder, overrides=overrides, mode=mode, end=end)
        ate_m, _ = errors(Path(folder) / "poses.csv", truth, mode == "mono")
        summary = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
    return Run(ate_m, bool(summary["trusted"]), tuple(summary["warnings"]))


def judge(complete: Run, without: Run) -> str:
    """Whether an addition makes a path worse, and whether the run says it."""
    if without.ate_m is None:
        return "" if complete.ate_m is None else "helps"
    if complete.ate_m is not None and complete.ate_m <= MAX_RATIO * without.ate_m + MAX_MORE_M:
        return "helps" if without.ate_m > MAX_RATIO * complete.ate_m + MAX_MORE_M else ""
    is_said = not complete.is_trusted or set(complete.warnings) - set(without.warnings)
    return "worse, and said" if is_said else "**harm**"


def _figure(ate_m: float | None) -> str:
    return "no path" if ate_m is None else f"{ate_m:.4f}"


if __name__ == "__main__":
    main()
