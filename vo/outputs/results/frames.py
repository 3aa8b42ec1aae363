"""Frames as known when they were processed, as lines of CSV."""

from __future__ import annotations

from collections.abc import Mapping

from vo.base.types import Estimate

# In the order of processing; other wall time is in the total only.
STAGES = (
    "read",
    "features",
    "start",
    "match",
    "align",
    "map",
    "window",
    "smooth",
    "memory",
    "inertial",
    "write",
    "record",
)

FRAMES_HEADING = ",".join(
    (
        *("frame", "stamp_ns", "state", "segment", "keyframe", "features", "matches", "inliers"),
        "total_ms",
        *(f"{stage}_ms" for stage in STAGES),
    )
)


def frame_line(estimate: Estimate, stage_ms: Mapping[str, float]) -> str:
    """One frame with its wall time by stage, 0 for a stage that was not run."""
    counts = (estimate.features, estimate.matches, estimate.inliers)
    place = (estimate.frame_index, estimate.stamp_ns, estimate.state.value, estimate.segment)
    spent = (sum(stage_ms.values()), *(stage_ms.get(stage, 0.0) for stage in STAGES))
    fields = (*place, int(estimate.is_keyframe), *counts, *(f"{ms:.3f}" for ms in spent))
    return ",".join(map(str, fields))
