"""Runs a second session in the map of a first one, with other light, noise and path.

Both recordings are rendered once, into --cache. The path of the first session is aligned with its
true one, in mono with a scale; the second session has the same alignment, without a fit of its own.
So its errors contain those of the map. Errors relative to the map are those of the position from
that of the nearest frame of the first session. Inertial sensors are not used.
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
from vo.base.geometry.similarity import umeyama
from vo.base.types import Floats, Ints
from vo.recordings.formats.trajectory import read_tum

ROOT = Path(__file__).resolve().parent.parent
COURSES = {
    "room": (
        *("scale=0.5", "motion=loop", "format=euroc", "world=room", "camera=pinhole"),
        *("seconds=40", "fps=10", "seed=1"),
    ),
    "street": (
        *("scale=0.4", "motion=car", "format=euroc", "world=street", "camera=kitti"),
        *("seconds=20", "fps=10", "seed=5"),
    ),
}
HEADING = (
    *("course", "mode", "frames", "in the map from frame", "localised", "the map, m"),
    *("median, m", "largest, m", "relative to the map, m", "`causal.tum`, m", "relative, m"),
)


def main() -> None:
    """Render, run and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "loops")
    parser.add_argument("--courses", default="room,street")
    parser.add_argument("--modes", default="stereo,mono")
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    print("| " + " | ".join(HEADING) + " |")
    print("|" + " --- |" * 2 + " ---: |" * (len(HEADING) - 2))
    for course in arguments.courses.split(","):
        first, second = (
            cached_sequence(
                load_recipe(None, [*COURSES[course], f"session={n}"]),
                arguments.cache,
                f"{course}_session_{n}",
            )
            for n in range(2)
        )
        for mode in arguments.modes.split(","):
            row = [course, mode, *_measure(first, second, mode)]
            print("| " + " | ".join(row) + " |", flush=True)


def _measure(first: Path, second: Path, mode: str) -> list[str]:
    with TemporaryDirectory() as folder:
        one, two, file = Path(folder, "1"), Path(folder, "2"), Path(folder, "course.map")
        _run(first, one, mode, "--loops", "--save-map", str(file))
        _run(second, two, mode, "--map", str(file), "--localize")
        path, true, _ = _pair(one / "trajectory.tum", first)
        world_from_map = umeyama(path, true, with_scale=mode == "mono")
        in_map = world_from_map.transform_points(path), true
        summary = json.loads((two / "summary.json").read_text())
        met = summary["map"]["met"]
        localised = sum(s["frames"] for s in summary["segments"] if s["segment"] in met)
        start = min((r["frame"] for r in summary["relocalisations"]), default=0)
        positions, true, _ = _pair(two / "trajectory.tum", second)
        found = world_from_map.transform_points(positions), true
        positions, true, frame = _pair(two / "causal.tum", second)
        causal = (
            world_from_map.transform_points(positions)[frame >= start],
            true[frame >= start],
        )
        return [
            str(summary["frames"]),
            str(start),
            f"{localised / summary['frames']:.0%}",
            f"{np.median(_errors(in_map)):.4f}",
            f"{np.median(_errors(found)):.4f}",
            f"{_errors(found).max():.4f}",
            f"{np.median(_errors_from(in_map, found)):.4f}",
            f"{np.median(_errors(causal)):.4f}",
            f"{np.median(_errors_from(in_map, causal)):.4f}",
        ]


def _run(recording: Path, output: Path, mode: str, *options: str) -> None:
    command = [sys.executable, "-m", "vo", "run", str(recording), "-o", str(output), "-q"]
    subprocess.run([*command, "--mode", mode, "--no-imu", *options], check=True, cwd=ROOT)


def _pair(file: Path, recording: Path) -> tuple[Floats, Floats, Ints]:
    """Positions (n, 3) of a path, the true ones, and numbers (n,) of the frames."""
    path, truth = read_tum(file), read_tum(recording / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, path.stamps_ns)
    return path.positions, truth.positions[rows], rows


def _errors(path: tuple[Floats, Floats]) -> Floats:
    """Errors (n,) in metres of positions (n, 3), given with the true ones."""
    return np.asarray(np.linalg.norm(path[0] - path[1], axis=1))


def _errors_from(in_map: tuple[Floats, Floats], path: tuple[Floats, Floats]) -> Floats:
    """Errors (n,) of positions relative to those of the nearest frames of the first session."""
    apart = np.linalg.norm(path[1][:, None] - in_map[1][None], axis=2)
    nearest = np.argmin(apart, axis=1)
    return _errors((path[0] - in_map[0][nearest], path[1] - in_map[1][nearest]))


if __name__ == "__main__":
    main()
