"""Where the CPU time of `vo run` goes: by feature, and by stage of the tracking thread.

Runs each recording with defaults, without each feature and for two frames, in turn, and compares
the least CPU times of all processes. An example:

  scripts/costs ../shared/data/kitti06_stereo_000-050 ../shared/data/rendered_hall_stereo --write
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from common import EXPERIMENTS, VoRun, parser_of, run_vo, write_section

PAGE = EXPERIMENTS / "where-time-goes.md"
_WITHOUT = {
    "loops": ["--no-loops"],
    "inertial sensor": ["--no-imu"],
    "corrections": [
        *("--set", "stereo.row_correction=false"),
        *("--set", "refinement.disparity_correction=false"),
        *("--set", "refinement.lens_correction=false"),
    ],
}
_STAGES = 6  # the longest ones


def main() -> None:
    """Print the tables; with `--write`, into their page too."""
    parser = parser_of("costs", __doc__, "write")
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--runs", type=int, default=5, help="of each kind; the fastest counts")
    parser.add_argument("--mode", default="auto", help="as for `vo run`")
    options = parser.parse_args()
    lines = [
        f"| recording | frames | CPU, s | start | {' | '.join(_WITHOUT)} | `--rrd` |",
        f"| --- | ---: | ---: | ---: |{' ---: |' * (len(_WITHOUT) + 1)}",
    ]
    stages = ["| recording | wall, s | stages of the tracking thread, s |", "| --- | ---: | --- |"]
    for recording in options.recordings:
        best, summary = _fastest(recording, options.runs, options.mode)
        total = best["complete"].cpu_s
        parts = [best["start"].cpu_s, *(total - best[name].cpu_s for name in _WITHOUT)]
        parts.append(best["rrd"].cpu_s - total)
        figures = " | ".join(f"{part:.2f} ({100.0 * part / total:.0f} %)" for part in parts)
        lines.append(f"| {recording.name} | {summary['frames']} | {total:.2f} | {figures} |")
        found = summary["profile"]["stages_ms"]
        longest = sorted(found, key=found.__getitem__, reverse=True)[:_STAGES]
        text = ", ".join(f"{name} {1e-3 * found[name]:.2f}" for name in longest)
        stages.append(f"| {recording.name} | {best['complete'].wall_s:.2f} | {text} |")
        print(lines[-1], stages[-1], sep="\n", flush=True)
    text = "\n".join([*lines, "", *stages])
    print(f"\n{text}")
    if options.write:
        write_section(PAGE, "costs", text)


def _fastest(recording: Path, runs: int, mode: str) -> tuple[dict[str, VoRun], dict[str, Any]]:
    """The run of least CPU time of each kind, and the summary of the complete one."""
    found: dict[str, list[VoRun]] = defaultdict(list)
    with tempfile.TemporaryDirectory(prefix="vo-costs-") as name:
        work = Path(name)
        kinds = {
            "complete": ["--profile"],
            "start": ["--end", "2"],
            "rrd": ["--rrd", str(work / "run.rrd")],
            **_WITHOUT,
        }
        for number in range(runs + 1):  # the first ones compile
            for kind, words in kinds.items():
                output = work / f"{kind}-{number}".replace(" ", "-")
                run = run_vo(recording, output, "--quiet", "--mode", mode, *words)
                if run.failure:
                    raise SystemExit(f"{recording}: {run.failure}")
                if number:
                    found[kind].append(run)
        best = {kind: min(some, key=lambda run: run.cpu_s) for kind, some in found.items()}
        return best, best["complete"].summary


if __name__ == "__main__":
    main()
