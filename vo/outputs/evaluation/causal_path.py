"""The causal path of a run without the poses that were only predicted."""

from __future__ import annotations

import csv
from contextlib import suppress
from pathlib import Path

import numpy as np

from vo.base.files.bounded_files import read_text
from vo.base.types import Bools, Trajectory

_FILES = ("frames.csv", "frames.csv.partial")  # the latter is written until a run ends


def tracked_part(causal: Trajectory, folder: Path) -> Trajectory:
    """The causal poses of frames that were tracked; all of them without `frames.csv`.

    Lost frames have a pose in `causal.tum`, too, if an inertial sensor predicts it.

    `causal`: the causal path, or a part of it.
    """
    kept = ~predicted(causal, folder)
    return Trajectory(causal.stamps_ns[kept], causal.world_from_cam[kept])


def predicted(causal: Trajectory, folder: Path) -> Bools:
    """(N,) which causal poses were predicted; none without `frames.csv`."""
    for name in _FILES:
        with suppress(OSError, ValueError, KeyError, TypeError, OverflowError, csv.Error):
            rows = csv.DictReader(read_text(folder / name).splitlines())
            lost = [int(row["stamp_ns"]) for row in rows if row["state"] != "tracking"]
            return np.isin(causal.stamps_ns, np.array(lost, np.int64))
    return np.zeros(len(causal), dtype=bool)
