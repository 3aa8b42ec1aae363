"""Measure the scale of mono runs by noisy positions; docs/experiments/scale-by-positions.md has it.

Runs `vo run --mode mono` once on each recording with ground truth, and then fits the scale to the
true positions with added noise, for a number of seeds: with white noise, with errors correlated
over 10 s, with outliers, with a jump, and with another clock. An example:

  scripts/scale ../shared/data/kitti07_mono_000-099 ../shared/data/kitti_raw_stereo_000-099
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import vo
from vo.base.records.placed_frames import PlacedFrames
from vo.base.types import Floats, Trajectory
from vo.runs.scaling.position_source import PositionSource
from vo.runs.scaling.positions import Positions

NOISE_M = 2.0
CORRELATED_S = 10.0


def main() -> None:
    """Print one row for each recording and kind of error."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--seeds", type=int, default=40)
    arguments = parser.parse_args()
    print("| recording | errors | rms error, % | mean sigma, % | covered | refused | told |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: |")
    for recording in arguments.recordings:
        path, truth = _tracked(recording)
        _rows(f"{recording.name}, {_length(truth):.0f} m", path, truth, arguments.seeds)
    truth = _circuit(200.0)
    _rows("exact path, 200 m", _as_path(truth), truth, arguments.seeds)


def _tracked(recording: Path) -> tuple[PlacedFrames, Trajectory]:
    truth = vo.open(recording, mode="mono").ground_truth
    assert truth is not None, f"{recording} has no ground truth"
    with tempfile.TemporaryDirectory() as folder:
        vo.run(recording, folder, mode="mono")
        return _as_path(vo.read_trajectory(Path(folder) / "trajectory.tum")), truth


def _as_path(trajectory: Trajectory) -> PlacedFrames:
    count = len(trajectory)
    zero, no = np.zeros(count, np.int64), np.zeros(count, bool)
    return PlacedFrames(np.arange(count), zero, zero, no, no, trajectory)


def _circuit(length_m: float) -> Trajectory:
    """A drive of 20 s with changing speed and a turn, at 10 Hz."""
    seconds = np.arange(0.0, 20.0, 0.1)
    along = length_m * (seconds / 20.0 + 0.03 * np.sin(0.6 * seconds)) / (1.0 + 0.03 * np.sin(12.0))
    heading = 1.2 / (1.0 + np.exp(-(along - 0.5 * length_m) / 8.0))
    steps = np.diff(along, prepend=0.0)
    poses = np.tile(np.eye(4), (len(seconds), 1, 1))
    poses[:, 0, 3] = np.cumsum(steps * np.sin(heading))
    poses[:, 2, 3] = np.cumsum(steps * np.cos(heading))
    return Trajectory((seconds * 1e9).astype(np.int64), poses)


def _length(truth: Trajectory) -> float:
    return float(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum())


def _white(rng: np.random.Generator, times_s: Floats) -> tuple[Floats, float]:
    return NOISE_M * rng.normal(size=(len(times_s), 3)), 0.0


def _correlated(rng: np.random.Generator, times_s: Floats) -> tuple[Floats, float]:
    errors = rng.normal(size=(len(times_s), 3))
    for row, step in enumerate(np.diff(times_s), start=1):
        kept = np.exp(-step / CORRELATED_S)
        errors[row] = kept * errors[row - 1] + np.sqrt(1.0 - kept**2) * errors[row]
    return NOISE_M * errors, 0.0


def _outliers(rng: np.random.Generator, times_s: Floats) -> tuple[Floats, float]:
    errors, _ = _white(rng, times_s)
    wrong = rng.random(len(times_s)) < 0.2
    errors[wrong] += 30.0 * rng.normal(size=(int(wrong.sum()), 3))
    return errors, 0.0


def _jump(rng: np.random.Generator, times_s: Floats) -> tuple[Floats, float]:
    errors, _ = _white(rng, times_s)
    first = int(rng.integers(len(times_s) // 4, 3 * len(times_s) // 4))
    direction = rng.normal(size=3)
    errors[first:] += 30.0 * direction / np.linalg.norm(direction)
    return errors, 0.0


def _late(rng: np.random.Generator, times_s: Floats) -> tuple[Floats, float]:
    return _white(rng, times_s)[0], 1.0


KINDS: dict[str, Callable[[np.random.Generator, Floats], tuple[Floats, float]]] = {
    "white": _white,
    "correlated over 10 s": _correlated,
    "20 % outliers of 30 m": _outliers,
    "a jump of 30 m": _jump,
    "clock 1 s late": _late,
}


def _rows(name: str, path: PlacedFrames, truth: Trajectory, seeds: int) -> None:
    exact = PositionSource(_positions(truth, np.zeros((len(truth), 3)), 0.0)).measure(path)
    true_scale = exact.scales[0].value
    times_s = 1e-9 * (truth.stamps_ns - truth.stamps_ns[0])
    for kind, make in KINDS.items():
        errors, sigmas, refused, told = [], [], 0, 0
        for seed in range(seeds):
            noise, late_s = make(np.random.default_rng(seed), times_s)
            found = PositionSource(_positions(truth, noise, late_s)).measure(path)
            told += bool(found.notes)
            if not found.scales:
                refused += 1
                continue
            (scale,) = found.scales
            errors.append(scale.value / true_scale - 1.0)
            sigmas.append(scale.relative_sigma)
        covered = np.abs(errors) <= 1.96 * np.array(sigmas)
        rms = np.sqrt(np.mean(np.square(errors))) if errors else float("nan")
        print(
            f"| {name} | {kind} | {100 * rms:.2f} | {100 * np.mean(sigmas):.2f} | "
            f"{int(covered.sum())} of {len(errors)} | {refused} | {told} |",
            flush=True,
        )


def _positions(truth: Trajectory, noise: Floats, late_s: float) -> Positions:
    stamps_ns = truth.stamps_ns + round(1e9 * late_s)
    unknown = np.full(len(truth), np.nan)
    return Positions("truth with noise", "gps", stamps_ns, truth.positions + noise, unknown)


if __name__ == "__main__":
    main()
