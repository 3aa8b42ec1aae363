"""Outputs that receive each pose as soon as it is known, and what they write of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from vo.base.faults import Fault
from vo.base.types import Estimate, Floats, KeyframePose, PredictedPose
from vo.recordings.formats.trajectory import pose_fields


class PoseUpdate(NamedTuple):
    """A frame that was just tracked."""

    estimate: Estimate
    record: bytes  # the same as JSON (docs/outputs.md), a single line without its end
    # whether the source goes on while an output waits, which must not wait then
    is_live: bool = False


class PoseSink(Protocol):
    """Receives the poses of a run."""

    name: str  # what messages call it

    def send(self, update: PoseUpdate) -> None:
        """Send one frame.

        Raises:
            BrokenPipeError: the only reader is gone; the run ends as after Ctrl-C.
            OSError: nothing more can be sent; the run goes on without this output.
        """

    def close(self) -> None:
        """After the last frame, however the run ended; must not wait long."""


_MAX_POSES = 2000


class ThinnedPath:
    """Poses of a run at even intervals of frames, which double whenever there are too many.

    `max_poses`: number of poses at which every second one is left out.
    """

    def __init__(self, max_poses: int = _MAX_POSES) -> None:
        self._max_poses = max_poses
        self._stride = 1
        self._count = 0
        self._frames: list[int] = []
        self._poses: list[Floats] = []

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, frame: int, pose: Floats) -> None:
        """Add the pose (4, 4) of a frame, or leave it out."""
        is_kept = self._count % self._stride == 0
        self._count += 1
        if not is_kept:
            return
        self._frames.append(frame)
        self._poses.append(pose)
        if len(self._poses) >= self._max_poses:
            del self._frames[1::2], self._poses[1::2]
            self._stride *= 2

    def withdraw_from(self, frame: int) -> None:
        """Remove the poses of this frame and all after it."""
        kept = sum(each < frame for each in self._frames)
        del self._frames[kept:], self._poses[kept:]

    def poses(self) -> Floats:
        """The poses (N, 4, 4)."""
        return np.reshape(self._poses, (-1, 4, 4))


SCHEMA_VERSION = 1
SCHEMA_FILE = Path(__file__).with_name("pose_record.schema.json")


class PoseRecords:
    """Makes the record of each frame; each of them can be understood without the others.

    `is_metric`: whether all lengths are metres, not units of the map. `faults`: of the whole
    recording; they are in the first record.
    """

    def __init__(self, *, is_metric: bool, faults: Sequence[Fault] = ()) -> None:
        self._is_metric = is_metric
        self._recording_faults = tuple(faults)
        self._known: KeyframePose | None = None  # the newest keyframe with a covariance

    def record(self, estimate: Estimate, *, is_metric: bool = False) -> dict[str, Any]:
        """The record of a frame; call it for all frames, in their order.

        `is_metric`: whether its lengths are metres, although not all are.
        """
        self._update_covariance(estimate)
        faults = self._recording_faults + estimate.faults
        self._recording_faults = ()
        failure, predicted = estimate.failure, estimate.predicted
        return {
            "schema_version": SCHEMA_VERSION,
            "frame": estimate.frame_index,
            "stamp_ns": estimate.stamp_ns,
            "state": estimate.state.value,
            "failure": None if failure is None else failure.reason.name.lower(),
            "segment": estimate.segment,
            "world_from_cam0": _pose(estimate.world_from_cam0),
            "length_unit": "m" if self._is_metric or is_metric else "map units",
            "is_keyframe": estimate.is_keyframe,
            "inliers": estimate.inliers,
            "covariance": None if predicted is not None else self._covariance(),
            "faults": [
                {"kind": f.kind.value, "is_handled": f.is_handled, "value": f.value} for f in faults
            ],
            "tracked_anew_from": estimate.tracked_anew_from,
            "dropped": estimate.dropped,
            "predicted": None if predicted is None else _prediction(predicted),
        }

    def _update_covariance(self, estimate: Estimate) -> None:
        if self._known is not None and self._known.segment != estimate.segment:
            self._known = None
        for keyframe in estimate.keyframes:
            if not _has_covariance(keyframe) or keyframe.segment != estimate.segment:
                continue
            if self._known is None or keyframe.frame_index >= self._known.frame_index:
                self._known = keyframe

    def _covariance(self) -> dict[str, Any] | None:
        if self._known is None or self._known.covariance is None:
            return None
        digits = _covariance(self._known.covariance)
        return {"keyframe": self._known.frame_index, "rx_ry_rz_tx_ty_tz": digits}


def encoded(record: dict[str, Any]) -> bytes:
    """A record as JSON on a single line, without the line's end."""
    return json.dumps(record, separators=(",", ":"), allow_nan=False).encode("ascii")


def _has_covariance(keyframe: KeyframePose) -> bool:
    return keyframe.covariance is not None and bool(np.isfinite(keyframe.covariance).all())


def _pose(world_from_cam0: Floats | None) -> dict[str, list[float]] | None:
    """Position and rotation with the digits of causal.tum."""
    if world_from_cam0 is None:
        return None
    numbers = [float(field) for field in pose_fields(world_from_cam0)]
    return {"position_xyz": numbers[:3], "quat_xyzw": numbers[3:]}


def _prediction(predicted: PredictedPose) -> dict[str, Any]:
    covariance = predicted.covariance
    if covariance is not None and not np.isfinite(covariance).all():
        covariance = None
    digits = None if covariance is None else _covariance(covariance)
    return {**(_pose(predicted.world_from_cam0) or {}), "rx_ry_rz_tx_ty_tz": digits}


def _covariance(covariance: Floats) -> list[list[float]]:
    return [[float(f"{c:.9e}") for c in row] for row in covariance.tolist()]
