"""Probability that a found instance is right.

A logistic function of what was measured, fitted to rendered scenes with known objects and to
images without any; docs/experiments/objects.md has how reliable it is.
"""

from __future__ import annotations

import numpy as np

THRESHOLD = 0.9
"""Confidence from which an object counts as found."""

# Intercept, then weights of the terms of `evidence`.
FLAT_WEIGHTS = (-18.0, 3.52, 3.34, 16.6)


def evidence(inliers: int, coverage: float, likeness: float) -> tuple[float, float, float]:
    """What the confidence of a flat instance is computed from.

    `inliers`: matches at different places that agree. `coverage`: ratio of the side inside the hull
    of these. `likeness`: ratio of the cells that look like the stored image.
    """
    return float(np.log(max(inliers, 1))), coverage, likeness


def flat_confidence(inliers: int, coverage: float, likeness: float) -> float:
    """Probability that a flat side is there, 0 to 1; arguments as for `evidence`."""
    intercept, *weights = FLAT_WEIGHTS
    total = intercept + float(np.dot(weights, evidence(inliers, coverage, likeness)))
    return float(1.0 / (1.0 + np.exp(-np.clip(total, -50.0, 50.0))))
