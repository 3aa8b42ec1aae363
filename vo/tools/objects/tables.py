"""What is found as plain values for JSON, and as lines of CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.printable import spreadsheet_row
from vo.tools.objects.stored_objects import FoundObject, StoredObject
from vo.tools.objects.tracks import Track

_HEADING = (
    *("frame", "stamp_ns", "track", "name", "side", "confidence", "inliers"),
    *(f"{axis}{n}" for n in range(1, 5) for axis in "uv"),
    *("tx", "ty", "tz", "qx", "qy", "qz", "qw", "source"),
)


class FrameObjects(NamedTuple):
    """Objects in a frame."""

    frame: int  # its number, 0 for an image
    stamp_ns: int | None  # its time, None for an image
    found: Sequence[FoundObject]
    tracks: Sequence[int]


def object_record(each: StoredObject) -> dict[str, Any]:
    """A stored object."""
    width = each.parts[0].unit_m * each.parts[0].image_size[0] if each.parts else float("nan")
    size = None if each.solid is None else np.ptp(each.solid.box, axis=0).round(4).tolist()
    return {
        "name": each.name,
        "images": each.images,
        "sides": len(each.parts),
        "features": each.features,
        "width_m": width if width == width else None,
        "size": size,
        "is_metric": None if each.solid is None else each.solid.is_metric,
    }


def frame_record(frame: FrameObjects) -> dict[str, Any]:
    """A frame with its objects."""
    objects = [
        {"track": track, **_found(each)}
        for each, track in zip(frame.found, frame.tracks, strict=True)
    ]
    return {"frame": frame.frame, "stamp_ns": frame.stamp_ns, "objects": objects}


def track_record(track: Track) -> dict[str, Any]:
    """An instance through a recording."""
    return {
        "track": track.id,
        "name": track.name,
        "frames": track.frames,
        "first": track.first,
        "last": track.last,
        "confidence": round(track.confidence, 4),
    }


def csv_text(sources: Sequence[tuple[str, Sequence[FrameObjects]]]) -> str:
    """All reports of sources by name, one a line; the pose is empty where it is not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADING)
    for source, frame in ((name, frame) for name, frames in sources for frame in frames):
        for each, track in zip(frame.found, frame.tracks, strict=True):
            stamp = "" if frame.stamp_ns is None else frame.stamp_ns
            pose: list[str] = [""] * 7
            if each.cam_from_object is not None:
                quat = quat_xyzw_from_rotation(each.cam_from_object[:3, :3])
                pose = [f"{value:.6f}" for value in (*each.cam_from_object[:3, 3], *quat)]
            corners = [f"{value:.2f}" for value in each.outline.ravel().tolist()]
            head = (frame.frame, stamp, track, each.name, each.part)
            row = (*head, f"{each.confidence:.4f}", each.inliers, *corners, *pose, source)
            writer.writerow(spreadsheet_row(row))
    return text.getvalue()


def _found(each: FoundObject) -> dict[str, Any]:
    pose = each.cam_from_object
    return {
        "name": each.name,
        "side": each.part,
        "confidence": round(each.confidence, 4),
        "inliers": each.inliers,
        "outline": each.outline.round(2).tolist(),
        "image_from_stored": None if each.homography is None else each.homography.tolist(),
        "cam_from_object": None if pose is None else pose.tolist(),
        "covariance": None if each.covariance is None else each.covariance.tolist(),
    }
