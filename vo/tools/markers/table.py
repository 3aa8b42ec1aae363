"""Markers as rows of numbers: JSON and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.files.complete_file import writing
from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Floats
from vo.tools.markers.image_markers import FrameMarkers, Marker, PlanePose

_CORNERS = [f"{axis}{n}" for n in range(4) for axis in "uv"]
COLUMNS = (
    *("frame", "stamp_ns", "id", *_CORNERS, "sigma_px"),
    *("tx", "ty", "tz", "qx", "qy", "qz", "qw"),
    *("sigma_m", "sigma_deg", "error_px", "other_error_px", "ambiguous"),
)


def marker_record(marker: Marker) -> dict[str, Any]:
    """Plain values of a marker for JSON."""
    detected = marker.detected
    return {
        "id": marker.id,
        "corners": np.round(detected.corners, 4).tolist(),
        "sigma_px": round(detected.sigma_px, 4),
        "side_px": round(detected.side_px, 2),
        "pose": None if marker.pose is None else pose_record(marker.pose),
    }


def pose_record(pose: PlanePose) -> dict[str, Any]:
    """Plain values of a pose for JSON."""
    return {
        "cam_from_marker": _matrix(pose.cam_from_marker),
        "distance_m": round(pose.distance_m, 6),
        "covariance": [[float(f"{value:.6g}") for value in row] for row in pose.covariance],
        "sigma_m": float(f"{pose.sigma_m:.4g}"),
        "sigma_deg": float(f"{pose.sigma_deg:.4g}"),
        "error_px": round(pose.error_px, 4),
        "ambiguous": pose.is_ambiguous,
        "other": None if pose.other is None else _matrix(pose.other),
        "other_error_px": None if pose.other is None else round(pose.other_error_px, 4),
    }


def frame_record(frame: FrameMarkers) -> dict[str, Any]:
    """Plain values of a frame for JSON."""
    board = {} if frame.board is None else {"board": pose_record(frame.board)}
    return {
        "frame": frame.frame_index,
        "stamp_ns": frame.stamp_ns,
        "markers": [marker_record(marker) for marker in frame.markers],
        **board,
    }


def write_csv(path: Path, frames: Iterable[FrameMarkers]) -> None:
    """Write a row for each marker in each frame; the pose is cam_from_marker.

    Raises:
        OutputError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for frame in frames:
        writer.writerows(_row(frame, marker) for marker in frame.markers)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text.getvalue(), encoding="utf-8")


def _row(frame: FrameMarkers, marker: Marker) -> Sequence[object]:
    detected, pose = marker.detected, marker.pose
    place = (frame.frame_index, frame.stamp_ns, marker.id)
    corners = [f"{value:.4f}" for value in (*detected.corners.ravel(), detected.sigma_px)]
    if pose is None:
        return (*place, *corners, *[""] * 12)
    quat = quat_xyzw_from_rotation(pose.cam_from_marker[:3, :3])
    numbers = (*pose.cam_from_marker[:3, 3], *quat, pose.sigma_m, pose.sigma_deg)
    other = "" if pose.other is None else f"{pose.other_error_px:.4f}"
    ends = (f"{pose.error_px:.4f}", other, int(pose.is_ambiguous))
    return (*place, *corners, *[f"{value:.7g}" for value in numbers], *ends)


def _matrix(transform: Floats) -> list[list[float]]:
    return [[float(f"{value:.9g}") for value in row] for row in transform.tolist()]
