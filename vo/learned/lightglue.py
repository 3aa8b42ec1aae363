"""Matches of two sets of features by a network: LightGlue, LighterGlue.

Source: Lindenberger et al., "LightGlue: local feature matching at light speed", ICCV 2023.
"""

from __future__ import annotations

import numpy as np

from vo.frontend.contracts import Matches
from vo.types import Floats, Floats32

MIN_PROBABILITY = 0.1  # the authors' threshold


def normalised(xy: Floats | Floats32, size: tuple[int, int]) -> Floats32:
    """Positions (N, 2), 0 in the middle of an image (width, height), 1 at half its longer side."""
    return ((xy - np.divide(size, 2.0)) / (max(size) / 2.0)).astype(np.float32)


def matches_of(log_assignment: Floats32, min_probability: float) -> Matches:
    """Pairs that are the most probable ones of both features; scores are 1 - probability.

    Args:
        log_assignment: (N, M) logarithms of the probability of each pair.
        min_probability: above which a pair is a match.
    """
    if 0 in log_assignment.shape:
        return Matches(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    train, query = log_assignment.argmax(axis=1), log_assignment.argmax(axis=0)
    every = np.arange(len(train))
    probability = np.exp(log_assignment[every, train].astype(np.float64))
    good = np.flatnonzero((query[train] == every) & (probability > min_probability))
    return Matches(good, train[good], 1.0 - probability[good])
