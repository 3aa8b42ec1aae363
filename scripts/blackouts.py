"""Runs `vo run` on recordings in which all images are black for a while, and on those without.

Recordings are EuRoC folders with an inertial sensor and ground truth. Images of all cameras are
replaced by black ones with noise, from 8 s on, again after every 10 s. ATE is that of all frames of
the longest world, aligned without scale. With `--predictions`, the motions since the last tracked
frame that are predicted in the dark are compared with the true ones instead.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import cv2
import numpy as np
from blackout_predictions import PREDICTIONS_HEADING, prediction_rows

from vo.base.geometry.similarity import umeyama
from vo.recordings.formats.trajectory import read_trajectory
from vo.recordings.sources.registry import open_source

_FIRST_S, _PERIOD_S = 8.0, 10.0
_GREY, _NOISE = 2.0, 1.5  # levels
HEADING = (
    "| recording | black, s | cameras | worlds | ATE without, m | ATE, m | in gaps, m | "
    "in gaps, ° |",
    "| --- | ---: | --- | ---: | ---: | ---: | ---: | ---: |",
)


class Outcome(NamedTuple):
    """Errors of a run, in metres and degrees; the largest ones of frames without a usable image."""

    worlds: int
    ate_m: float
    gap_m: float
    gap_deg: float


def main() -> int:
    """Run all, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path, help="EuRoC folders")
    parser.add_argument("--black", type=float, nargs="+", default=[1.0], help="seconds of each gap")
    parser.add_argument("--no-imu", action="store_true", help="without the inertial sensor")
    parser.add_argument("--predictions", action="store_true", help="errors of predicted poses")
    arguments = parser.parse_args()
    options = ["--no-imu"] if arguments.no_imu else []
    if arguments.predictions:
        print("\n".join(PREDICTIONS_HEADING), flush=True)
        for recording in arguments.recordings:
            predictions(recording, arguments.black)
        return 0
    print("\n".join(HEADING), flush=True)
    for recording in arguments.recordings:
        for mode in ("mono", "stereo"):
            usual = measure(recording, mode, options)
            for seconds in arguments.black:
                with TemporaryDirectory(dir=recording.parent) as folder:
                    dark = blackened(recording, Path(folder) / recording.name, seconds)
                    found = measure(dark, mode, options)
                row = f"| {name_of(recording)} | {seconds:g} | {mode} | {found.worlds} "
                row += f"| {usual.ate_m:.4f} | {found.ate_m:.4f} "
                print(row + f"| {found.gap_m:.3f} | {found.gap_deg:.2f} |", flush=True)
    return 0


def predictions(recording: Path, black: list[float]) -> None:
    """Print the errors of predicted poses."""
    for mode in ("mono", "stereo"):
        for seconds in black:
            with TemporaryDirectory(dir=recording.parent) as folder:
                dark = blackened(recording, Path(folder) / recording.name, seconds)
                for row in prediction_rows(dark, mode):
                    print(f"| {name_of(recording)} | {mode} | {row}", flush=True)


def name_of(recording: Path) -> str:
    """Name of a recording in tables."""
    return re.sub(r"-[0-9a-f]{10}$", "", recording.name)


def blackened(recording: Path, copy: Path, seconds: float) -> Path:
    """A copy, by links where images stay, with black images; the copy."""
    shutil.copytree(recording, copy, copy_function=os.link)
    rng = np.random.default_rng(1)
    for folder in sorted(copy.glob("mav0/cam*/data")):
        images = sorted(folder.glob("*.png"))
        since_s = 1e-9 * np.array([int(image.stem) - int(images[0].stem) for image in images])
        black = (since_s >= _FIRST_S) & ((since_s - _FIRST_S) % _PERIOD_S < seconds)
        for n in np.flatnonzero(black).tolist():
            image = cv2.imread(str(images[n]), cv2.IMREAD_GRAYSCALE)
            assert image is not None
            images[n].unlink()  # a link; the original stays
            noise = rng.normal(_GREY, _NOISE, image.shape).clip(0, 255).astype(np.uint8)
            cv2.imwrite(str(images[n]), noise)
    return copy


def measure(recording: Path, mode: str, options: list[str]) -> Outcome:
    """Errors of a run."""
    with TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        command = [sys.executable, "-I", "-m", "vo", "run", str(recording), "-o", str(output)]
        command += ["--mode", mode, "--quiet", *options]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        summary = json.loads((output / "summary.json").read_text("utf-8"))
        rows = np.loadtxt(output / "poses.csv", delimiter=",", skiprows=1)
        path = read_trajectory(output / "trajectory.tum")
    truth = open_source(recording).ground_truth
    assert truth is not None
    chosen = rows[:, 2] == np.bincount(rows[:, 2].astype(int)).argmax()
    poses, stamps = path.world_from_cam[chosen], path.stamps_ns[chosen]
    at = np.searchsorted(truth.stamps_ns, stamps - 1_000_000).clip(0, len(truth) - 1)
    true = truth.world_from_cam[at]
    fit = umeyama(poses[:, :3, 3], true[:, :3, 3], with_scale=False)
    moved = poses[:, :3, 3] @ fit.rotation.T + fit.translation
    error = np.linalg.norm(moved - true[:, :3, 3], axis=1)
    turned = (fit.rotation @ poses[:, :3, :3]) * true[:, :3, :3]
    cosine = 0.5 * (turned.sum(axis=(1, 2)) - 1.0)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    gap = rows[chosen, 4] == 2
    return Outcome(
        len(summary["segments"]),
        float(np.sqrt((error**2).mean())),
        float(error[gap].max(initial=0.0)),
        float(angle[gap].max(initial=0.0)),
    )


if __name__ == "__main__":
    sys.exit(main())
