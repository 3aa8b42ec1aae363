"""What random matches would give: how many must fit before a model of two images means anything.

Source: Moisan and Stival, "A probabilistic criterion to detect rigid point matches between two
images", IJCV 2004: the expected number of models, over all samples, with as many inliers.
"""

from __future__ import annotations

import math

import numpy as np

from vo.base.types import Bools, Floats
from vo.tools.pairs.two_view_records import Evidence, ModelKind

_SAMPLE = {ModelKind.FUNDAMENTAL: 7, ModelKind.ESSENTIAL: 5, ModelKind.HOMOGRAPHY: 4}
_MAX_LOG10_FALSE_ALARMS = -3.0  # one in a thousand pairs
_SAME_PLACE = 0.006  # of the diagonal of the spread: features so near show the same thing
_MIN_SAME_PLACE_PX = 3.0
_MAX_HIT_RATIO = 0.5


def evidence(
    kind: ModelKind, first: Floats, second: Floats, inlier: Bools, threshold_px: float
) -> Evidence:
    """Compare the inliers of a model with those of random matches of the same spread.

    Features at one place (several orientations of one corner, neighbours in one patch) are matched
    to one place by the same mistake, so they count once. The inliers' own spread is what a random
    match would have to hit: learned matchers put wrong matches close together, too.
    """
    radius = [_same_place(xy) for xy in (first, second)]
    order = np.argsort(~inlier, kind="stable")
    kept = order[_separate(first[order], second[order], radius)]
    inliers, matches = int(inlier[kept].sum()), len(kept)
    spread = inlier if inliers > _SAMPLE[kind] else np.ones(len(inlier), dtype=bool)
    hit_ratio = max(_hit_ratio(kind, xy[spread], threshold_px) for xy in (first, second))
    needed = _SAMPLE[kind] + 1
    while _log10_false_alarms(kind, matches, needed, hit_ratio) > _MAX_LOG10_FALSE_ALARMS:
        needed += 1
    return Evidence(inliers, matches, needed)


def _same_place(xy: Floats) -> float:
    return max(_MIN_SAME_PLACE_PX, _SAME_PLACE * float(np.hypot(*np.ptp(xy, axis=0))))


def _separate(first: Floats, second: Floats, radius: list[float]) -> list[int]:
    """Rows of which no two are near each other in either image; earlier ones are preferred."""
    free = np.ones(len(first), dtype=bool)
    kept = []
    for row in range(len(first)):
        if free[row]:
            kept.append(row)
            for xy, near in zip((first, second), radius, strict=True):
                free &= ((xy - xy[row]) ** 2).sum(axis=1) > near**2
    return kept


def _hit_ratio(kind: ModelKind, xy: Floats, threshold_px: float) -> float:
    """Ratio of the area that points cover, as a uniform density, within reach of a model."""
    variances = np.maximum(np.linalg.eigvalsh(np.cov(xy.T)), 1e-12)
    length, width = np.sqrt(12.0 * variances[::-1])
    reach = math.sqrt(2.0) * threshold_px  # a Sampson distance is shared by two images
    covered = math.pi * reach**2 if kind is ModelKind.HOMOGRAPHY else 2.0 * reach * length
    return min(float(covered / (length * width)), _MAX_HIT_RATIO)


def _log10_false_alarms(kind: ModelKind, matches: int, inliers: int, hit_ratio: float) -> float:
    """Expected number of models of random matches, of all samples, with as many inliers."""
    sample, total = _SAMPLE[kind], max(matches, inliers)
    samples = math.log(total - sample)
    samples += _log_choices(total, inliers) + _log_choices(inliers, sample)
    return (samples + (inliers - sample) * math.log(hit_ratio)) / math.log(10.0)


def _log_choices(total: int, chosen: int) -> float:
    return math.lgamma(total + 1) - math.lgamma(chosen + 1) - math.lgamma(total - chosen + 1)
