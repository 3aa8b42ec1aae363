"""Damages inputs of all kinds at random and reads them, in processes with limited memory and time.

Every input has to end as read or with one line of error. A traceback, the end of the process, a
hang (60 s), or more than 700 MB of memory are failures; then the exit status is 1, and the damaged
input is kept in --keep.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import select
import shutil
import subprocess
import sys
import tempfile
import threading
import traceback
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from fuzz_beside import sealed
from fuzz_kinds import Sample
from fuzz_samples import make_samples

VO = Path(sys.executable).with_name("vo")
OUTCOMES = ("error line", "read", "traceback", "hang", "memory")
_FAILURES = OUTCOMES[2:]
_MAX_GROWTH_MB = 700
_MAX_ADDRESS_SPACE = 6 * 2**30
_TIMEOUT_S = 60.0
_CLI_EVERY = 100  # of the cases of a kind, one is read by the real command
_COMMANDS = {
    "recording": ("info", "{}"),
    "calibration": ("info", "{}"),
    "trajectory": ("eval", "{}", "{}"),
    "report": ("report", "{}", "-o", "{}.html"),
    "config": ("run", ".", "--config", "{}", "-o", "{}.out"),
    "positions": ("run", ".", "--mode", "mono", "--scale-from", "{}", "-o", "{}.out"),
    "markers": ("run", ".", "--mode", "mono", "--marker-map", "{}", "-o", "{}.out"),
    "manifest": ("batch", "--manifest", "{}", "-o", "{}.out"),
    "imu": ("info", "{}"),
    "mesh": ("render", "a.run", "--model", "{}", "-o", "{}.png"),
    "map": ("map", "info", "{}"),
    "vocabulary": ("run", ".", "--set", "memory.vocabulary={}", "-o", "{}.out"),
    "objects": ("recognize", "list", "--database", "{}"),
    "batch": ("compare", "{}", "{}"),
}


class Result(NamedTuple):
    """Outcome of a case, one of `OUTCOMES`, and its last line."""

    outcome: str
    line: str


def main() -> None:
    """Run all cases, print the counts of each kind, and exit with 1 after a failure."""
    options = _options()
    if options.worker:
        _work()
        return
    with tempfile.TemporaryDirectory(prefix="vo-fuzz-") as name:
        samples = make_samples(Path(name))
        chosen = [s for s in samples if options.only in s.kind]
        _check_undamaged(chosen)
        counts, failed = _run(chosen, options, Path(name) / "cases")
    print(table(counts))
    if failed:
        print(f"\n{len(failed)} failures:", *failed, sep="\n")
        raise SystemExit(1)


def table(counts: dict[str, Counter[str]]) -> str:
    """The counts as a table in Markdown, one row for each group of kinds."""
    groups: dict[str, Counter[str]] = {}
    for kind, counter in counts.items():
        group = groups.setdefault(kind.split()[0].partition("_")[0], Counter())
        group.update(counter)
        group["kinds"] += 1
    rows = [f"| input | kinds | inputs | {' | '.join(OUTCOMES)} |", "| --- |" + " ---: |" * 7]
    total: Counter[str] = sum(groups.values(), Counter())
    for group, counter in [*groups.items(), ("all", total)]:
        found = [counter[outcome] for outcome in OUTCOMES]
        cells = [counter["kinds"], sum(found), *found]
        rows.append(f"| {group} | {' | '.join(f'{cell:,}' for cell in cells)} |")
    return "\n".join(rows)


def _run(
    samples: list[Sample], options: argparse.Namespace, root: Path
) -> tuple[dict[str, Counter[str]], list[str]]:
    jobs = iter([(sample, number) for sample in samples for number in range(options.count)])
    counts = {sample.kind: Counter[str]() for sample in samples}
    failed: list[str] = []
    lock = threading.Lock()

    def work(folder: Path) -> None:
        worker = _Worker()
        while True:
            with lock:
                job = next(jobs, None)
            if job is None:
                worker.stop()
                return
            sample, number = job
            seed = f"{options.seed} {sample.kind} {number}"
            path = _damaged(sample, folder, random.Random(seed))
            is_last = number % _CLI_EVERY == _CLI_EVERY - 1
            result = _command(sample, path) if is_last else worker.read(sample.reader, path, number)
            with lock:
                counts[sample.kind][result.outcome] += 1
                if result.outcome in _FAILURES:
                    failed.append(f"{result.outcome}: {sample.kind}, case {number}: {result.line}")
                    _keep(options.keep, folder, sample, number)

    threads = [threading.Thread(target=work, args=(root / str(n),)) for n in range(options.jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return counts, sorted(failed)


def _check_undamaged(samples: list[Sample]) -> None:
    """Refuse samples that are not even read without damage."""
    worker = _Worker()
    bad = [
        f"{sample.kind}: {result.line}"
        for sample in samples
        for number in range(2)
        if (result := worker.read(sample.reader, sample.folder / sample.path, number)).outcome
        != "read"
    ]
    worker.stop()
    if bad:
        raise SystemExit("\n".join(["not read without damage:", *bad]))


def _damaged(sample: Sample, folder: Path, rng: random.Random) -> Path:
    """A damaged copy of a sample."""
    from fuzz_mutations import damage

    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sample.folder, folder)
    files = sorted(
        file
        for file in folder.rglob("*")
        if file.is_file() and (not sample.suffixes or file.suffix in sample.suffixes)
    )
    file = rng.choice(files)
    damage(file, rng)
    sealed(file)
    return folder / sample.path


def _keep(keep: Path | None, folder: Path, sample: Sample, number: int) -> None:
    if keep is not None:
        target = keep / f"{sample.kind} {number}"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder, target)


def _command(sample: Sample, path: Path) -> Result:
    words = [word.format(path) for word in _COMMANDS[sample.reader]]
    try:
        done = subprocess.run(
            [VO, *words],
            cwd=path.parent,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Result("hang", f"vo {words[0]}")
    text = done.stdout + done.stderr
    if "Traceback" in text or done.returncode not in (0, 1, 2, 3):
        return Result("traceback", f"vo {words[0]}: {text.strip().splitlines()[-1:]}")
    return Result("read" if done.returncode in (0, 3) else "error line", "")


class _Worker:
    """A process that reads one input after another; replaced when it hangs or dies."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def read(self, reader: str, path: Path, number: int) -> Result:
        """Read an input in the process."""
        process = self._process = self._process or self._start()
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps([reader, str(path), number]) + "\n")
        process.stdin.flush()
        is_ready, _, _ = select.select([process.stdout], [], [], _TIMEOUT_S)
        answer = process.stdout.readline() if is_ready else ""
        if answer:
            result = Result(*json.loads(answer))
            if result.outcome == "memory":
                self.stop()  # its peak stays
            return result
        self.stop()
        if not is_ready:
            return Result("hang", f"{_TIMEOUT_S:.0f} s")
        return Result("traceback", f"the process ended with status {process.returncode}")

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        self._process = None

    @staticmethod
    def _start() -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, __file__, "--worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )


def _work() -> None:
    """Read the inputs named on standard input, and print their outcomes."""
    import fuzz_readers

    resource.setrlimit(resource.RLIMIT_AS, (_MAX_ADDRESS_SPACE, _MAX_ADDRESS_SPACE))
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        before = _peak_mb()
        result = _result(fuzz_readers, *json.loads(line))
        growth = _peak_mb() - before
        if growth > _MAX_GROWTH_MB:
            result = Result("memory", f"{growth:.0f} MB")
        print(json.dumps(result), file=answers, flush=True)


def _result(readers: Any, reader: str, path: str, number: int) -> Result:
    try:
        line = readers.read(reader, Path(path), number)
    except MemoryError as error:
        return Result("memory", repr(error))
    except Exception as error:
        places = traceback.extract_tb(error.__traceback__)
        ours = [p for p in places if "/vo/" in p.filename] or places
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return Result("traceback", f"{type(error).__name__}: {str(error)[:120]} ({where})")
    return Result("read" if line == "read" else "error line", line[:200])


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="damaged inputs of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", metavar="TEXT", help="kinds that contain the text")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep inputs that fail here")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    main()
