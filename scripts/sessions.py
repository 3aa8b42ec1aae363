"""Runs a second session in the map of a first one, with other light, noise and path.

Both recordings are rendered once, into --cache. The path of the first session is aligned with its
true one, in mono with a scale; the second session has the same alignment, without a fit of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from data_synth.cache import cached_sequence
from data_synth.recipe import load_recipe
from vo.formats.trajectory import read_tum
from vo.geometry.similarity import Similarity, umeyama
from vo.types import Floats, Ints

ROOT = Path(__file__).resolve().parent.parent
COURSE = ("scale=0.5", "motion=loop", "format=euroc", "world=room", "camera=pinhole")
TIMES = ("seconds=40", "fps=10", "seed=1")


def main() -> None:
    """Render, run and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "loops")
    parser.add_argument("--modes", default="stereo,mono")
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    first, second = (
        cached_sequence(
            load_recipe(None, [*COURSE, *TIMES, f"session={n}"]), arguments.cache, f"session_{n}"
        )
        for n in range(2)
    )
    heading = ["mode", "frames", "in the map from frame", "localised", "median, m", "largest, m"]
    print("| " + " | ".join([*heading, "causal median, m"]) + " |")
    print("|" + " --- |" + " ---: |" * len(heading))
    for mode in arguments.modes.split(","):
        print("| " + " | ".join(_measure(first, second, mode)) + " |", flush=True)


def _measure(first: Path, second: Path, mode: str) -> list[str]:
    with TemporaryDirectory() as folder:
        one, two, file = Path(folder, "1"), Path(folder, "2"), Path(folder, "room.map")
        _run(first, one, mode, "--loops", "--save-map", str(file))
        _run(second, two, mode, "--map", str(file), "--localize")
        path, true, _ = _pair(one / "trajectory.tum", first)
        world_from_map = umeyama(path, true, with_scale=mode == "mono")
        summary = json.loads((two / "summary.json").read_text())
        met = summary["map"]["met"]
        localised = sum(s["frames"] for s in summary["segments"] if s["segment"] in met)
        start = min((r["frame"] for r in summary["relocalisations"]), default=0)
        errors, _ = _errors(two / "trajectory.tum", second, world_from_map)
        causal, frame = _errors(two / "causal.tum", second, world_from_map)
        return [
            mode,
            str(summary["frames"]),
            str(start),
            f"{localised / summary['frames']:.0%}",
            f"{np.median(errors):.4f}",
            f"{errors.max():.4f}",
            f"{np.median(causal[frame >= start]):.4f}",
        ]


def _run(recording: Path, output: Path, mode: str, *options: str) -> None:
    command = [sys.executable, "-m", "vo", "run", str(recording), "-o", str(output), "-q"]
    subprocess.run([*command, "--mode", mode, *options], check=True, cwd=ROOT)


def _pair(file: Path, recording: Path) -> tuple[Floats, Floats, Ints]:
    """Positions (n, 3) of a path, the true ones, and numbers (n,) of the frames."""
    path, truth = read_tum(file), read_tum(recording / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, path.stamps_ns)
    return path.positions, truth.positions[rows], rows


def _errors(file: Path, recording: Path, world_from_map: Similarity) -> tuple[Floats, Ints]:
    """Errors (n,) of positions in metres, and numbers of the frames."""
    path, true, frame = _pair(file, recording)
    moved = world_from_map.transform_points(path)
    return np.asarray(np.linalg.norm(moved - true, axis=1)), frame


if __name__ == "__main__":
    main()
