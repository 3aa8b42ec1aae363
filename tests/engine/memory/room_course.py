"""Runs of the rendered rounds through a room, and their errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.config import load_config
from vo.base.geometry.similarity import umeyama
from vo.outputs.evaluation.pose_errors import absolute_errors
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")
END = 190  # frames: a round takes 126
BLACK, CHANGED = 112, 124  # first black frame, and the first of the place in negative
LENGTH_M, DICTIONARY = 0.3, "4X4_50"  # of markers


def run_rounds(recording: Path, output: Path, *settings: str, **options: Any) -> dict[str, Any]:
    """Run with settings, without the inertial sensor; the summary."""
    config = load_config("default", ["inertial.enabled=false", *settings])
    run(recording, output, config=config, **options)
    summary: dict[str, Any] = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    return summary


def ate(folder: Path, recording: Path, name: str = "trajectory.tum") -> float:
    """Absolute trajectory error in metres, after alignment with a scale."""
    found, truth = read_tum(folder / name), read_tum(recording / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, found.stamps_ns)
    similarity = umeyama(found.positions, truth.positions[rows], with_scale=True)
    errors = absolute_errors(
        similarity.transform_poses(found.world_from_cam), truth.world_from_cam[rows]
    )
    return float(np.sqrt(np.mean(errors.translation_m**2)))
