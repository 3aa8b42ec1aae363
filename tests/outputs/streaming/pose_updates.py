"""Estimates of a short made-up run, and the updates that outputs of poses receive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Estimate, KeyframePose, State
from vo.outputs.streaming.sink import PoseRecords, PoseUpdate, encoded

BEGUN_NS = 1_700_000_000_123_456_789


def pose(frame: int) -> np.ndarray:
    return make_transform(
        so3_exp(np.array([0.0, 0.1, 0.0]) * frame), np.array([0.5, 0.0, 1.0 * frame])
    )


def estimate(frame: int, **changes: object) -> Estimate:
    tracked = Estimate(
        frame_index=frame,
        stamp_ns=BEGUN_NS + frame * 50_000_000,
        state=State.TRACKING,
        failure=None,
        segment=0,
        world_from_cam0=pose(frame),
        is_keyframe=False,
        features=200,
        matches=150,
        inliers=140,
        keyframes=(),
    )
    return replace(tracked, **changes)  # type: ignore[arg-type]


def lost(frame: int, **changes: object) -> Estimate:
    failed: dict[str, object] = {
        "state": State.LOST,
        "failure": Failure(FailureReason.FEW_INLIERS),
        "world_from_cam0": None,
        "inliers": 0,
    }
    return estimate(frame, **failed | changes)


def keyframe(frame: int, variance: float | None, segment: int = 0) -> KeyframePose:
    covariance = None if variance is None else np.eye(6) * variance
    return KeyframePose(frame, BEGUN_NS + frame * 50_000_000, segment, pose(frame), covariance)


FAULT = Fault(FaultKind.BLURRED_IMAGES, is_handled=True, value=1.5)


def update(frame: int) -> PoseUpdate:
    result = estimate(frame)
    return PoseUpdate(result, encoded(PoseRecords(is_metric=True).record(result)))
