"""Errors of the poses that are predicted while images are black, beside their stated sigma."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from vo.base.config import load_config
from vo.base.geometry.transforms import adjoint, inverse, se3_log
from vo.base.types import Floats, KeyframePose, Trajectory
from vo.outputs.streaming.sink import PoseUpdate
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

_AFTER_S = (0.25, 0.5, 1.0)
PREDICTIONS_HEADING = (
    "| recording | cameras | after, s | frames | error, mm | stated, mm | error, ° | stated, ° "
    "| NEES / 6 |",
    "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
)


class _Prediction(NamedTuple):
    """A predicted motion: since the last tracked frame, and from the keyframe before it."""

    since_ns: int
    keyframe_ns: int
    stamp_ns: int
    keyframe_from_cam: Floats
    covariance: Floats


class _Predictions:
    """Collects predicted poses of a run.

    Attributes:
        found: so far.
    """

    name = "predictions"

    def __init__(self) -> None:
        self.found: list[_Prediction] = []
        self._known: KeyframePose | None = None
        self._tracked_ns = 0

    def send(self, update: PoseUpdate) -> None:
        """Keep the prediction of a frame."""
        estimate = update.estimate
        for keyframe in estimate.keyframes:
            if keyframe.covariance is not None and (
                self._known is None or keyframe.frame_index >= self._known.frame_index
            ):
                self._known = keyframe
        if estimate.world_from_cam0 is not None:
            self._tracked_ns = estimate.stamp_ns
        if estimate.predicted is None:
            return
        known, (pose, covariance) = self._known, estimate.predicted
        assert known is not None and covariance is not None and known.covariance is not None
        motion = inverse(known.world_from_cam0) @ pose
        moved = adjoint(inverse(motion))
        covariance = covariance - moved @ known.covariance @ moved.T
        stamps = self._tracked_ns, known.stamp_ns, estimate.stamp_ns
        self.found.append(_Prediction(*stamps, motion, covariance))

    def close(self) -> None:
        """Nothing is open."""


def prediction_rows(recording: Path, mode: str) -> Iterator[str]:
    """Root mean squares over all gaps at some times after the last tracked frame, for a table."""
    sink = _Predictions()
    with TemporaryDirectory() as folder:
        run(recording, Path(folder) / "out", config=load_config(), mode=mode, poses=[sink])
    truth = open_source(recording).ground_truth
    assert truth is not None
    gaps: dict[int, list[_Prediction]] = {}
    for each in sink.found:
        gaps.setdefault(each.since_ns, []).append(each)
    for after in _AFTER_S:
        late = [
            [p for p in gap if p.stamp_ns - p.since_ns >= 1e9 * after - 1e6]
            for gap in gaps.values()
        ]
        chosen = [gap[0] for gap in late if gap]
        if chosen:
            yield _row(after, chosen, truth)


def _row(after: float, chosen: list[_Prediction], truth: Trajectory) -> str:
    errors = np.array([_error(p, truth) for p in chosen])
    sigma = np.array([np.diag(p.covariance) for p in chosen])
    nees = [e @ np.linalg.solve(p.covariance, e) for e, p in zip(errors, chosen, strict=True)]
    turned, moved = (np.sqrt((errors[:, k] ** 2).sum(axis=1).mean()) for k in _PARTS)
    turn_sigma, move_sigma = (np.sqrt(sigma[:, k].sum(axis=1).mean()) for k in _PARTS)
    return (
        f"{after:g} | {len(chosen)} | {1e3 * moved:.1f} | {1e3 * move_sigma:.1f} "
        f"| {np.degrees(turned):.2f} | {np.degrees(turn_sigma):.2f} | {np.mean(nees) / 6:.2f} |"
    )


_PARTS = (slice(0, 3), slice(3, 6))


def _error(prediction: _Prediction, truth: Trajectory) -> Floats:
    """(6,) tangent on the right, rotation first."""
    stamps_ns = np.array([prediction.keyframe_ns, prediction.stamp_ns])
    first, last = truth.world_from_cam[np.searchsorted(truth.stamps_ns, stamps_ns - 1_000_000)]
    return se3_log(inverse(prediction.keyframe_from_cam) @ inverse(first) @ last)
