"""Checks of stamps: rates, gaps, and offsets between cameras."""

from __future__ import annotations

import numpy as np

from vo.base.types import Ints
from vo.recordings.sources.pairing import tolerance_ns
from vo.tools.inspection.image_records import Gap, PairReport, Timing
from vo.tools.inspection.opening import ImageSequence, right_stamps

_GAP = 1.5
"""Shortest interval that counts as a gap, in median intervals."""

_BINS = 9


def timing_of(camera: ImageSequence) -> Timing:
    """Rate, jitter and gaps of a camera."""
    stamps_ns = _stamps(camera)
    steps = np.diff(stamps_ns)
    median = float(np.median(steps)) if len(steps) else 0.0
    gaps = tuple(
        Gap(
            after_frame=int(i),
            at_s=1e-9 * float(stamps_ns[i] - stamps_ns[0]),
            seconds=1e-9 * float(steps[i]),
            missing=max(1, round(float(steps[i]) / median) - 1),
        )
        for i in np.flatnonzero(steps > _GAP * median)
    )
    regular = steps[steps <= _GAP * median]
    jitter_ns = float(np.percentile(np.abs(regular - median), 95)) if len(regular) else 0.0
    return Timing(
        count=len(stamps_ns),
        first_ns=int(stamps_ns[0]),
        span_s=1e-9 * float(stamps_ns[-1] - stamps_ns[0]),
        rate_hz=1e9 / median if median else 0.0,
        jitter_ms=1e-6 * jitter_ns,
        gaps=gaps,
        repeated_stamps=camera.repeated_stamps,
    )


def pair_report(left: ImageSequence, right: ImageSequence) -> PairReport:
    """Pairing of left and right images, and their offsets in time."""
    stamps_ns, others_ns = _stamps(left), _stamps(right)
    paired_ns = right_stamps(left.shots, right.shots)
    paired = paired_ns >= 0
    nearest_ns = paired_ns[paired] - stamps_ns[paired]
    if not len(nearest_ns):  # no pair: report the offsets of the nearest images
        after = np.clip(np.searchsorted(others_ns, stamps_ns), 1, max(1, len(others_ns) - 1))
        after = np.minimum(after, len(others_ns) - 1)
        both = np.stack([others_ns[after], others_ns[np.maximum(after - 1, 0)]]) - stamps_ns
        rows = np.abs(both).argmin(axis=0)
        nearest_ns = both[rows, np.arange(len(stamps_ns))]
    offsets_ms = 1e-6 * nearest_ns.astype(np.float64)
    count = int(paired.sum())
    return PairReport(
        pairs=count,
        left_alone=len(stamps_ns) - count,
        right_alone=len(others_ns) - count,
        offset_ms=float(np.median(offsets_ms)),
        offsets_ms=(float(offsets_ms.min()), float(offsets_ms.max())),
        histogram=_histogram(offsets_ms),
        tolerance_ms=1e-6 * tolerance_ns(stamps_ns),
    )


def _histogram(values: np.ndarray) -> tuple[tuple[float, int], ...]:
    if values.max() - values.min() < 1e-6:
        return ((float(values[0]), len(values)),)
    counts, edges = np.histogram(values, bins=_BINS)
    return tuple((float(e), int(c)) for e, c in zip(edges[:-1], counts, strict=True))


def _stamps(camera: ImageSequence) -> Ints:
    return np.array([shot.stamp_ns for shot in camera.shots], dtype=np.int64)
