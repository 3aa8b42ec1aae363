"""Runs batches of many short recordings and checks that each costs only itself.

One recording in ten is bad: missing, empty, truncated, a pipe into which nobody writes, or images
that need more memory than `--memory` allows. The batch is killed by SIGKILL some times and called
again. At the end all good recordings must be done and all bad ones listed, no recording may have
been done twice, and results must have the bytes of `vo run` alone. Then throughput: recordings by
single runs, pinned to two cores each, against the batch, and with --ray against a local Ray
cluster. With --tasks, the overhead of Ray for as many tasks of a second.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

from vo.base.scheduling import available_cores
from vo.runs.batch.tables import read_batch

ROOT = Path(__file__).resolve().parent.parent
VO = ROOT / ".venv" / "bin" / "vo"
RECIPE = ["world=room", "motion=handheld", "camera=pinhole", "scale=0.5", "speed=1"]
FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")
BAD = ("missing", "empty", "truncated", "hanging", "memory")
_TIMEOUT_S, _MEMORY_MB = 45.0, 3000


def main() -> None:
    """Make the recordings, run the batches, and print what was found."""
    options = _options()
    with tempfile.TemporaryDirectory(prefix="vo-batch-") as name:
        work = Path(name)
        kinds = make_recordings(work, options.count, options.frames)
        problems = check_batch(work, kinds, options.kills)
        problems += check_bytes(work, kinds, options.same)
        print_throughput(work, kinds, options.single, ray=options.ray)
    if options.tasks:
        print_overhead(options.tasks, options.slots)
    print("\n".join(problems) or "no problem")
    sys.exit(1 if problems else 0)


def make_recordings(work: Path, count: int, frames: int) -> dict[str, str]:
    """Recordings in `sources` and `manifest.csv`; the kind of each by name."""
    source = work / "long"
    (work / "sources").mkdir()
    words = [word for each in [*RECIPE, "seconds=12"] for word in ("--set", each)]
    subprocess.run([VO, "synth", source, "-q", *words], check=True)
    names = sorted(path.name for path in (source / "mav0" / "cam0" / "data").iterdir())
    kinds: dict[str, str] = {}
    random.seed(0)
    for number in range(count):
        name = f"r{number:03d}"
        kinds[name] = BAD[number // 10 % len(BAD)] if number % 10 == 7 else "good"
        first = random.randrange(len(names) - frames)
        _make(source, work / "sources" / name, names[first : first + frames], kinds[name])
    rows = [
        f"{work / 'sources' / name}{'.mcap' if kind == 'hanging' else ''},{name},{kind}"
        for name, kind in kinds.items()
    ]
    (work / "manifest.csv").write_text("source,name,kind\n" + "\n".join(rows) + "\n")
    return kinds


def _make(source: Path, target: Path, images: list[str], kind: str) -> None:
    if kind == "missing":
        return
    if kind == "hanging":
        os.mkfifo(target.with_suffix(".mcap"))
        return
    target.mkdir(parents=True)
    if kind == "empty":
        return
    for camera in sorted((source / "mav0").glob("cam*")):
        copy = target / "mav0" / camera.name
        (copy / "data").mkdir(parents=True)
        shutil.copy(camera / "sensor.yaml", copy)
        head, *rows = (camera / "data.csv").read_text().splitlines()
        kept = [row for row in rows if row.partition(",")[2].strip() in images]
        (copy / "data.csv").write_text("\n".join([head, *kept]) + "\n")
        for image in images:
            if kind == "truncated":
                data = (camera / "data" / image).read_bytes()
                (copy / "data" / image).write_bytes(data[: len(data) // 3])
            elif kind == "memory":
                cv2.imwrite(str(copy / "data" / image), np.zeros((20000, 30000), np.uint8))
                break
            else:
                os.link(camera / "data" / image, copy / "data" / image)
    for truth in source.glob("groundtruth*"):
        shutil.copy(truth, target)


def batch(work: Path, output: Path, *words: str) -> subprocess.Popen[bytes]:
    """A started batch of all recordings."""
    limits = ["--timeout", str(_TIMEOUT_S), "--memory", str(_MEMORY_MB), "--retries", "0"]
    return subprocess.Popen(
        [VO, "batch", "--manifest", work / "manifest.csv", "-o", output, *limits, "-q", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def check_batch(work: Path, kinds: dict[str, str], kills: int) -> list[str]:
    """Run the batch, killed some times on the way; what is wrong with its results."""
    output, problems = work / "out", list[str]()
    done: dict[str, int] = {}
    for number in range(kills):
        process = batch(work, output)
        target = (number + 1) * len(kinds) // (kills + 1)
        while len(list(output.glob("r*/result.json"))) < target and process.poll() is None:
            time.sleep(0.2)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        now = finished(output)
        problems += [f"{n} was done twice" for n in done if now.get(n) != done[n]]
        done = now
    begun = time.monotonic()
    status = batch(work, output).wait()
    now = finished(output)
    problems += [f"{name} was done twice" for name in done if now.get(name) != done[name]]
    results = {result.name: result for result in read_batch(output)}
    for name, kind in kinds.items():
        is_done = name in results and results[name].is_done
        if is_done != (kind == "good"):
            problems.append(f"{name} ({kind}): {results.get(name)}")
        elif not is_done and not results[name].error:
            problems.append(f"{name} ({kind}) has no error line")
    if status != 4:
        problems.append(f"exit status {status}, expected 4")
    left = [path.name for path in output.iterdir() if path.name not in _expected(kinds)]
    problems += [f"{name} was left in the output" for name in left]
    counts = Counter(f"{kinds[name]}: {result.status}" for name, result in results.items())
    print(f"{len(kinds)} recordings, {kills} kills, last call {time.monotonic() - begun:.0f} s")
    print(*(f"  {count} {what}" for what, count in sorted(counts.items())), sep="\n")
    return problems


def _expected(kinds: dict[str, str]) -> set[str]:
    return {*kinds, "failed", "batch.json", "batch.csv", "index.html"}


def finished(output: Path) -> dict[str, int]:
    """Modification times of the finished results by name."""
    return {path.parent.name: path.stat().st_mtime_ns for path in output.glob("r*/result.json")}


def check_bytes(work: Path, kinds: dict[str, str], count: int) -> list[str]:
    """Differences between results of the batch and `vo run` alone, for some recordings."""
    problems = []
    good = [name for name, kind in kinds.items() if kind == "good"][:count]
    for name in good:
        alone = work / "alone" / name
        subprocess.run([VO, "run", work / "sources" / name, "-o", alone, "-q"], check=True)
        problems += [
            f"{name}/{file} has other bytes than `vo run` alone"
            for file in FILES
            if (alone / file).read_bytes() != (work / "out" / name / file).read_bytes()
        ]
    print(f"{len(good)} results compared with `vo run` alone")
    return problems


def print_throughput(work: Path, kinds: dict[str, str], count: int, *, ray: bool) -> None:
    """Recordings per minute of batches, relative to single runs that are pinned to their cores.

    Single runs are done at the same time, as many as the batch has, each on cores of its own.
    """
    good = [name for name, kind in kinds.items() if kind == "good"][:count]
    rows = [f"{work / 'sources' / name},{name}" for name in good]
    (work / "good.csv").write_text("source,name\n" + "\n".join(rows) + "\n")
    cores, lanes = available_cores(), max(1, available_cores() // 2)
    begun = time.monotonic()
    processes = []
    for lane in range(lanes):
        own = f"{lane * 2}-{min(cores - 1, lane * 2 + 1)}"
        runs = " && ".join(
            f"taskset -c {own} {VO} run {work / 'sources' / name} -o {work / 'single' / name} -q"
            for name in good[lane::lanes]
        )
        processes.append(subprocess.Popen(["bash", "-c", runs]))
    for process in processes:
        process.wait()
    single = time.monotonic() - begun
    print(f"{len(good)} single runs in {lanes} lanes of 2 cores: {single:.1f} s")
    for name, words in {"vo batch": [], "vo batch --ray local": ["--ray", "local"]}.items():
        if words and not ray:
            continue
        begun = time.monotonic()
        command = [VO, "batch", "--manifest", work / "good.csv", "-o", work / name.split()[-1]]
        subprocess.run([*command, "-q", *words], check=True)
        wall = time.monotonic() - begun
        print(f"{name}: {wall:.1f} s, throughput {single / wall:.2f}")


def print_overhead(tasks: int, slots: int) -> None:
    """Time that Ray adds to tasks of a second, as `RayEngine` hands them out."""
    import ray

    ray.init(num_cpus=slots, include_dashboard=False, log_to_driver=False)
    task = ray.remote(num_cpus=1)(_sleep)
    ray.get([task.remote(0.0) for _ in range(slots)])  # starts the workers
    begun = time.monotonic()
    waiting: list[object] = []
    left = tasks
    while left or waiting:
        new = min(left, 4 * slots - len(waiting))
        waiting += [task.remote(1.0) for _ in range(new)]
        left -= new
        _, waiting = ray.wait(waiting, num_returns=1, timeout=0.5)
    wall = time.monotonic() - begun
    ideal = -(-tasks // slots)
    each = 1e3 * (wall - ideal) / tasks * slots
    print(
        f"Ray: {tasks} tasks of 1 s in {slots} slots: {wall:.1f} s, ideal {ideal} s; "
        f"{each:.0f} ms for each task in its slot, {1e3 * (wall - ideal) / tasks:.1f} ms in all"
    )
    ray.shutdown()


def _sleep(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="scripts/batch_soak",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=200, help="recordings")
    parser.add_argument("--frames", type=int, default=20, help="of each recording, up to 200")
    parser.add_argument("--kills", type=int, default=3, help="SIGKILLs of the batch")
    parser.add_argument("--same", type=int, default=20, help="results compared with single runs")
    parser.add_argument("--single", type=int, default=20, help="runs for the throughput")
    parser.add_argument("--ray", action="store_true", help="throughput with Ray too")
    parser.add_argument("--tasks", type=int, default=0, help="simulated tasks of a second on Ray")
    parser.add_argument("--slots", type=int, default=64, help="of them at the same time")
    return parser.parse_args()


if __name__ == "__main__":
    main()
