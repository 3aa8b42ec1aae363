"""Rows of the tables of a trajectory, and what they stand for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import inverse, whole_transforms
from vo.base.records.metric_scale import MetricScale
from vo.base.types import Floats, Ints, KeyframePose
from vo.engine.trajectory.map_frame import Anchor, scaled_covariance

FRAME = np.dtype(
    [
        ("frame_index", np.int64),
        ("stamp_ns", np.int64),
        ("segment", np.int32),
        ("keyframe", np.int32),  # id, not decreasing
        ("fraction", np.float64),  # of the time between two tracked frames, 0 for a tracked one
        ("keyframe_from_cam", np.float64, (3, 4)),
    ]
)
KEYFRAME = np.dtype(
    [
        ("id", np.int64),
        ("frame_index", np.int64),
        ("stamp_ns", np.int64),
        ("segment", np.int32),
        ("odom_from_cam0", np.float64, (3, 4)),  # in the odometry frame
        ("world_from_cam0", np.float64, (3, 4)),  # in the map frame
        ("scale", np.float64),  # length in the map frame of one unit of the odometry frame
        # As tracked, in units of the odometry; NaN if frames between them have no pose.
        ("previous_from_cam", np.float64, (3, 4)),
        ("odom_covariance", np.float64, (21,)),  # upper triangle, NaN if unknown
        ("covariance", np.float64, (21,)),
    ]
)
TRIANGLE = np.triu_indices(6)
_UNKNOWN = np.full((6, 6), np.nan)


def keyframe_rows(
    keyframes: Sequence[int], poses: Sequence[KeyframePose], anchors: Mapping[int, Anchor]
) -> NDArray[Any]:
    """Rows (n,) of n > 0 keyframes with poses of odometry; anchors by segment."""
    rows = np.zeros(len(poses), KEYFRAME)
    rows["id"] = keyframes
    for name in ("frame_index", "stamp_ns", "segment"):
        rows[name] = [getattr(pose, name) for pose in poses]
    odom_from_cam0 = np.array([pose.world_from_cam0 for pose in poses])
    covariance = np.array([_UNKNOWN if p.covariance is None else p.covariance for p in poses])
    i, j = TRIANGLE
    rows["odom_from_cam0"] = rows["world_from_cam0"] = odom_from_cam0[:, :3]
    rows["odom_covariance"] = rows["covariance"] = covariance[:, i, j]
    rows["scale"], rows["previous_from_cam"] = 1.0, np.nan
    for segment in sorted(set(rows["segment"].tolist()) & anchors.keys()):
        anchor, chosen = anchors[segment], np.flatnonzero(rows["segment"] == segment)
        rows["world_from_cam0"][chosen] = anchor.transform(odom_from_cam0[chosen])[:, :3]
        rows["scale"][chosen] = anchor.scale
        known = chosen[np.isfinite(covariance[chosen, 0, 0])]
        in_map = anchor.covariance(odom_from_cam0[known], covariance[known])
        rows["covariance"][known] = in_map[:, i, j]
    return rows


def symmetric(triangles: Floats) -> Floats:
    """(n, 6, 6) matrices of their upper triangles (n, 21)."""
    result = np.zeros((len(triangles), 6, 6))
    i, j = TRIANGLE
    result[:, i, j] = result[:, j, i] = triangles
    return result


def apply_scale(table: NDArray[Any], rows: Ints, scale: MetricScale) -> None:
    """Convert rows (n,) of the table of keyframes to metres."""
    poses = whole_transforms(table["world_from_cam0"][rows])
    poses[:, :3, 3] *= scale.value
    table["world_from_cam0"][rows] = poses[:, :3]
    table["scale"][rows] *= scale.value
    covariance = scaled_covariance(symmetric(table["covariance"][rows]), scale.value)
    to_origin = -inverse(poses)[:, :3, 3]
    by_scale = to_origin[:, :, None] * to_origin[:, None, :]
    covariance[:, 3:, 3:] += scale.relative_sigma**2 * by_scale
    i, j = TRIANGLE
    table["covariance"][rows] = covariance[:, i, j]


def keyframe_poses(rows: NDArray[Any]) -> list[KeyframePose]:
    """Keyframes in the map frame."""
    world_from_cam0 = whole_transforms(rows["world_from_cam0"])
    covariances: list[Floats | None] = list(symmetric(rows["covariance"]))
    for row in np.flatnonzero(~np.isfinite(rows["covariance"][:, 0])).tolist():
        covariances[row] = None
    place = [rows[name].tolist() for name in ("frame_index", "stamp_ns", "segment")]
    scale = rows["scale"].tolist()
    return list(map(KeyframePose, *place, world_from_cam0, covariances, scale))
