"""Compares the results of `vo run` in two checkouts, byte for byte, and their CPU time.

Each checkout runs on the real recordings and the synthetic suite, in stereo and mono, with every
preset. Results of the old checkout can be kept (--keep) and are then reused.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from common import options_of, parser_of, real_recordings, run_vo, suite, write_tum_calibration

FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")
PRESETS = ("default", "fast", "accurate")
MODES = ("stereo", "mono")
# A stereo and a mono recording, a pair that is not rectified, and one that tracking loses.
QUICK = (
    ("kitti06_stereo_000-050", "stereo", "default"),
    ("kitti07_mono_000-099", "mono", "default"),
    ("kitti_raw_stereo_000-099", "stereo", "default"),
    ("rendered_hall_stereo", "stereo", "fast"),
    ("rendered_hall_stereo", "mono", "accurate"),
    ("tum_fr3_cabinet_58_lowtexture", "mono", "default"),
)


@dataclass(frozen=True)
class Case:
    """One run: a recording, a mode and a preset."""

    recording: Path
    mode: str
    preset: str

    @property
    def name(self) -> str:
        """Unique name, also of its folder."""
        return f"{self.recording.name}-{self.mode}-{self.preset}"


@dataclass(frozen=True)
class Run:
    """Result of one run."""

    folder: Path
    status: int
    cpu_s: float  # CPU time of the command and of its child processes


def main() -> None:
    """Run, compare, print a line for each case; exit status 1 if any file differs."""
    options = _options()
    with tempfile.TemporaryDirectory(prefix="vo-same-bits-") as name:
        work = Path(name)
        calibration = write_tum_calibration(work)
        kept = options.keep or work / "old"
        cases = [case for case in _cases(options) if options.only in case.name]
        if not cases:
            raise SystemExit("error: no recording to compare; check --data and --only")

        def compare(case: Case) -> tuple[Case, list[str], float]:
            old = _old_run(options.old, case, kept / case.name, calibration)
            new = _run(options.new, case, work / "new" / case.name, calibration)
            return case, _differences(old, new), new.cpu_s / old.cpu_s

        with ThreadPoolExecutor(options.jobs) as pool:
            results = [_printed(*result) for result in pool.map(compare, cases)]
    differing = [name for name, same in results if not same]
    print(f"{len(results) - len(differing)} of {len(results)} runs are byte-identical")
    if differing:
        raise SystemExit(1)


def _options() -> argparse.Namespace:
    parser = parser_of("same_bits", __doc__, "only", "data", "cache", "keep")
    add = parser.add_argument
    add("old", type=Path, help="checkout with the expected results (after its scripts/setup)")
    add("new", type=Path, help="checkout to compare with it")
    add("--quick", action="store_true", help="six runs only, on real recordings")
    add("--jobs", type=int, default=1, metavar="N", help="runs at the same time")
    return parser.parse_args()


def _cases(options: argparse.Namespace) -> Iterator[Case]:
    if options.quick:
        for name, mode, preset in QUICK:
            if (options.data / name).is_dir():
                yield Case(options.data / name, mode, preset)
        return
    folders = real_recordings(options.data) + [make() for make in suite(options.cache).values()]
    for folder, mode, preset in product(folders, MODES, PRESETS):
        yield Case(folder, mode, preset)


def _old_run(checkout: Path, case: Case, folder: Path, calibration: Path) -> Run:
    record = folder / "run.json"
    if record.is_file():
        return Run(folder, **json.loads(record.read_text(encoding="utf-8")))
    run = _run(checkout, case, folder, calibration)
    folder.mkdir(parents=True, exist_ok=True)
    content = {"status": run.status, "cpu_s": run.cpu_s}
    record.write_text(json.dumps(content), encoding="utf-8")
    return run


def _run(checkout: Path, case: Case, folder: Path, calibration: Path) -> Run:
    words = ["--mode", case.mode, "--config", case.preset, "--quiet"]
    words += options_of(case.recording, calibration)
    vo = checkout.resolve() / ".venv" / "bin" / "vo"
    run = run_vo(case.recording, folder, *words, vo=vo)
    return Run(folder, run.status, run.cpu_s)


def _differences(old: Run, new: Run) -> list[str]:
    """What differs: names of files, or the exit status."""
    if old.status != new.status:
        return [f"exit status {old.status} -> {new.status}"]
    return [name for name in FILES if _content(old.folder / name) != _content(new.folder / name)]


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


def _printed(case: Case, differences: list[str], cpu_ratio: float) -> tuple[str, bool]:
    verdict = "DIFFERS: " + ", ".join(differences) if differences else "same"
    print(f"{case.name:58} CPU x{cpu_ratio:.2f}  {verdict}", flush=True)
    return case.name, not differences


if __name__ == "__main__":
    main()
