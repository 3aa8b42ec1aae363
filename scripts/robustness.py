"""Runs `vo run` on recordings with faults, and compares with the clean ones.

Prints a row for each situation: the error of the path, that of the clean recording, the share of
frames with a pose, the longest step relative to the clean one, and what the run said. The exit
status is 1 if a path is wrong and the run says that it can be trusted, or if the clean recordings
give a false alarm. A path is wrong if its ATE exceeds 3 times that of the clean recording, and
2 mm + 0.05 % of the path.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from common import (
    EXPERIMENTS,
    options_of,
    parser_of,
    real_recordings,
    suite,
    write_section,
    write_tum_calibration,
)
from robustness_cases import CLIPS, Case, cases
from robustness_clips import Clip, Clips, true_poses, write_euroc
from robustness_generated import Generated, generated
from robustness_run import Outcome, max_ate_m, run
from robustness_store import Store
from robustness_table import CleanRow, Row, clean_line, document, line

from vo.base.types import Floats
from vo.recordings.sources.registry import open_source

PAGE = EXPERIMENTS / "injected-faults.md"
MODES = ("stereo", "mono")


def main() -> None:
    """Run, print the rows, and write the requested files."""
    options = _options()
    chosen = [c for c in cases(options.vo) if _is_chosen(c, options)]
    others = [] if options.quick else generated(options.data)
    others = [each for each in others if options.only in each.name]
    if options.list:
        print("\n".join(case.name for case in (*chosen, *others)))
        return
    clips = Clips(options.data, options.cache)
    rows: dict[str, Row] = {}
    clean: list[CleanRow] = []
    with tempfile.TemporaryDirectory(prefix="vo-robustness-") as name:
        bench = _Bench(options.vo, clips, Path(name), options.keep)
        chosen_of = {c.name: c for c in sorted(chosen, key=lambda c: CLIPS.index(c.clip))}
        todo: dict[str, Callable[[], Row | CleanRow | None]] = {
            **{n: partial(bench.row, case) for n, case in chosen_of.items()},  # each clip read once
            **{each.name: partial(bench.generated_row, each, options.data) for each in others},
            **dict(_clean_runs(options, Path(name))),
        }
        for title, found in _measured(todo, Store(options.json, options.vo)):
            if isinstance(found, Row):
                rows[title] = found
            else:
                clean.append(found)
    if not rows and not clean:
        raise SystemExit("error: nothing to run; check --data and --only")
    in_order = [rows[case.name] for case in (*chosen, *others) if case.name in rows]
    _write(options, in_order, clean)
    wrong = [row for row in in_order if row.is_wrong_and_trusted]
    alarms = [row for row in clean if row.false_alarms]
    print(f"{len(rows)} rows, {len(wrong)} wrong and trusted; ", end="")
    print(f"{len(clean)} clean runs, {len(alarms)} with false alarms")
    if wrong or alarms:
        raise SystemExit(1)


def _measured(
    todo: dict[str, Callable[[], Row | CleanRow | None]], store: Store
) -> Iterator[tuple[str, Row | CleanRow]]:
    """Rows by name, printed and stored one by one."""
    for done, (name, measure) in enumerate(todo.items(), 1):
        begin = time.perf_counter()
        if (found := store.find(name)) is None and (found := measure()) is not None:
            store.add(name, found, time.perf_counter() - begin)
        if found is not None:
            text = line(found) if isinstance(found, Row) else clean_line(found)
            print(f"{done}/{len(todo)}  {text}", flush=True)
            yield name, found


class _Bench:
    """Makes recordings, and runs the command on them."""

    def __init__(self, vo: Path, clips: Clips, work: Path, keep: Path | None) -> None:
        self._vo, self._clips, self._work, self._keep = vo, clips, work, keep
        self._clean: dict[str, Outcome] = {}

    def row(self, case: Case) -> Row | None:
        clip = self._clips.get(case.clip)
        if clip is None:
            _say(f"{case.name}: the recording does not exist, skipped")
            return None
        clean = self._clean_outcome(case.clip, clip)
        faulty = case.fault(clip)
        with tempfile.TemporaryDirectory(dir=self._work) as folder:
            kept = self._keep / _file_name(case.name) if self._keep else Path(folder) / "case"
            recording = case.write(faulty, kept / "recording")
            outcome = run(self._vo, recording, faulty.truth_of_frames, kept / "out")
        limit = max_ate_m(clean, faulty.truth, case.floor_ratio)
        names = (case.situation, case.variant, case.clip)
        return Row(*names, outcome, clean, limit, case.is_visible)

    def generated_row(self, situation: Generated, data: Path) -> Row:
        """Make a recording by its generator, and compare it with the one that it is made of."""
        recording, options = data / situation.clean, situation.options
        with tempfile.TemporaryDirectory(dir=self._work) as name:
            folder = Path(name)
            made = folder / ("positions.csv" if situation.is_file else "recording")
            situation.make(self._vo, data, made)
            source = recording if situation.is_file else made
            words = (*options, str(made)) if situation.is_file else options
            truth = _truth(source)
            outcome = run(self._vo, source, truth, folder / "out", words)
            key = " ".join((situation.clean, *options))
            if key not in self._clean:
                words, clean = options, recording
                if situation.is_file:
                    control = situation._replace(words=("OUT", "ctrl"))
                    control.make(self._vo, data, folder / "clean.csv")
                    words = (*options, str(folder / "clean.csv"))
                elif "--markers" in options:  # which give metres: one that stays is the clean one
                    clean = folder / "marker"
                    situation._replace(words=("OUT", "marker1")).make(self._vo, data, clean)
                self._clean[key] = run(self._vo, clean, _truth(clean), folder / "clean", words)
        expected = self._clean[key]
        names = (situation.situation, situation.variant, situation.mode)
        return Row(*names, outcome, expected, max_ate_m(expected, truth))

    def _clean_outcome(self, name: str, clip: Clip) -> Outcome:
        if name not in self._clean:
            with tempfile.TemporaryDirectory(dir=self._work) as folder:
                recording = write_euroc(clip, Path(folder) / "clean")
                self._clean[name] = run(self._vo, recording, clip.truth, Path(folder) / "out")
        return self._clean[name]


def _clean_runs(
    options: argparse.Namespace, work: Path
) -> Iterator[tuple[str, Callable[[], CleanRow | None]]]:
    """Names of runs on recordings as they are, and what runs them: real ones, then the suite."""
    calibration = write_tum_calibration(work)
    for name, folder_of in _clean_recordings(options):
        for mode in MODES:
            title = f"clean, {name}, {mode}"
            if options.no_clean or options.only not in title:
                continue
            arguments = ("--mode", mode, *options_of(Path(name), calibration))
            yield title, partial(_clean_run, options.vo, title, folder_of, work, arguments)


def _clean_recordings(options: argparse.Namespace) -> Iterator[tuple[str, Callable[[], Path]]]:
    """Names, and functions that give the folder; those of the suite are made where missing."""
    yield from ((folder.name, partial(Path, folder)) for folder in real_recordings(options.data))
    if not options.quick:
        yield from suite(options.cache).items()


def _clean_run(
    vo: Path, title: str, folder_of: Callable[[], Path], work: Path, arguments: tuple[str, ...]
) -> CleanRow | None:
    """The row, None where the recording has no right camera."""
    folder = folder_of()
    calibration = Path(arguments[-1]) if "--calibration" in arguments else None
    source = open_source(folder, calibration=calibration)
    if "stereo" in arguments and not source.rig.is_stereo:
        return None
    with tempfile.TemporaryDirectory(dir=work) as output:
        truth = _truth(folder, calibration)
        return CleanRow(title, run(vo, folder, truth, Path(output) / "out", arguments))


def _truth(folder: Path, calibration: Path | None = None) -> Floats:
    source = open_source(folder, calibration=calibration, mode="mono")
    assert source.ground_truth is not None
    return true_poses(source.ground_truth, source.stamps_ns)


def _options() -> argparse.Namespace:
    shared = ("only", "keep", "vo", "data", "cache")
    parser = parser_of("robustness", __doc__, *shared)
    add = parser.add_argument
    add("--json", type=Path, metavar="FILE", help="append each row to this file (JSON Lines), and "
        "take those of the same commit from it: calls may be broken off, and share it")  # fmt: skip
    add("--list", action="store_true", help="print the names of the rows, and exit")
    add("--quick", action="store_true", help="one strength of each situation, no synthetic suite")
    add("--no-clean", action="store_true", help="without the runs that count false alarms")
    add("--markdown", type=Path, metavar="FILE", nargs="?", const=PAGE, help="write the tables; "
        "without a file into docs/experiments/injected-faults.md")  # fmt: skip
    options = parser.parse_args()
    if options.markdown == PAGE and options.only:
        parser.error("the page needs all situations: leave out --only")
    return options


def _is_chosen(case: Case, options: argparse.Namespace) -> bool:
    return options.only in case.name and (case.is_quick or not options.quick)


def _write(options: argparse.Namespace, rows: list[Row], clean: list[CleanRow]) -> None:
    if options.markdown == PAGE:
        write_section(PAGE, "table", f"{_made_by(options)}\n\n{document(rows, clean)}")
    elif options.markdown:
        options.markdown.write_text(document(rows, clean) + "\n", encoding="utf-8")


def _made_by(options: argparse.Namespace) -> str:
    """How the tables were made, for the page."""
    words = ["scripts/robustness"]
    words += ["--quick"] * options.quick + ["--no-clean"] * options.no_clean + ["--markdown"]
    which = "one strength of each situation" if options.quick else "all strengths"
    return f"Made by `{' '.join(words)}`: {which}."


def _file_name(name: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in name)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
