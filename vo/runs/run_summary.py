"""The summary of a run from what its odometry has found."""

from __future__ import annotations

from typing import Any

from vo.engine.rig.creation import AnyOdometry
from vo.outputs.results.run_statistics import RunStatistics
from vo.outputs.results.summary import RunFacts, Status, Summary, summarise


def summarise_odometry(
    odometry: AnyOdometry, facts: RunFacts, status: Status, statistics: RunStatistics, **found: Any
) -> Summary:
    """Summary of a run so far; `found` are its fields that the odometry does not know."""
    path, map_alignment = odometry.trajectory, odometry.map_alignment
    known = {
        "keyframes": path.keyframe_count,
        "hidden": odometry.hidden,
        "loops": map_alignment.closed_loops,
        "relocalisations": map_alignment.relocalisations,
        "map": map_alignment.map_use,
        "networks": tuple(network._asdict() for network in odometry.networks),
        "inertial": map_alignment.inertial,
        "has_free_scale": not path.metric.by_cameras,
    }
    errors = odometry.calibration_errors
    return summarise(facts, status, statistics, path.path(), errors, **{**known, **found})
