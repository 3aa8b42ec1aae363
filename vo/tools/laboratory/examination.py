"""What a method finds in one image."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from vo.base.scheduling import one_opencv_thread
from vo.base.types import Floats32, Keypoints
from vo.tools.laboratory.images import GreyImage
from vo.tools.laboratory.methods import Method

_COLUMNS = 16  # of square cells across the image
_REPEATS, _ENOUGH_S = 3, 1.0  # times that it is run, and after which time it is not run again


@dataclass(frozen=True)
class FeatureReport:
    """Features of one image."""

    method: str
    count: int
    by_octave: tuple[int, ...]  # number of features by octave, from 0
    spread: float  # ratio of cells with a feature, of square cells, 16 across the image
    response: tuple[float, float] | None  # weakest and strongest response; None without features
    descriptor: str
    ms: float  # CPU time of detection and description in one thread


def examine(method: Method, image: GreyImage) -> tuple[FeatureReport, Keypoints]:
    """Extract features, several times if it is fast; the shortest time counts."""
    times: list[float] = []
    with one_opencv_thread():
        while not times or (len(times) < _REPEATS and sum(times) < _ENOUGH_S):
            begin = time.process_time()
            found = method.extract(image.pixels, image.mask)
            times.append(time.process_time() - begin)
    width = found.descriptor.shape[1]
    report = FeatureReport(
        method.name,
        len(found),
        tuple(np.bincount(found.octave).tolist()),
        spread(found.xy, image.pixels.shape),
        (float(found.response.min()), float(found.response.max())) if len(found) else None,
        f"{width} x {found.descriptor.dtype}" if width else "",
        1e3 * min(times),
    )
    return report, found


def spread(xy: Floats32, shape: tuple[int, ...]) -> float:
    """Ratio of square cells, 16 across an image of shape (H, W), that have a point (N, 2)."""
    height, width = shape
    side = width / _COLUMNS
    rows = max(1, round(height / side))
    column = np.clip((xy[:, 0] + 0.5) / side, 0, _COLUMNS - 1).astype(np.int64)
    row = np.clip((xy[:, 1] + 0.5) / height * rows, 0, rows - 1).astype(np.int64)
    return len(np.unique(row * _COLUMNS + column)) / (rows * _COLUMNS)
