"""A finished run: its recording, as the run has opened it, and its poses."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.base.records.focal_length import FocalLength
from vo.base.types import Floats, Mode
from vo.outputs.report.run_folder import RunRecord, table_rows
from vo.outputs.results.folder import CAMERA
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.rescaling import at_constant_focal_length
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.source import Recording


def recording_of(record: RunRecord, source: str | None = None) -> Recording:
    """Open the recording of a run, None for where it was, with the focal length that it followed.

    Raises:
        SourceError: it is not there, or damaged.
    """
    summary = record.summary
    mode: Mode = "mono" if summary["mode"] == "mono" else "auto"
    estimated = str(record.path / CAMERA) if summary.get("estimated_camera") else None
    stream = open_source(
        Path(str(summary["source"]) if source is None else source),
        format=str(summary["format"]),
        calibration=summary.get("calibration") or estimated,
        mode=mode,
        topics=summary.get("topics", ()),
        right_offset_ns=summary.get("right_offset_ns"),
    )
    focal = [FocalLength(**each) for each in summary.get("focal_lengths") or ()]
    if focal and isinstance(stream, ImageSequence):
        return at_constant_focal_length(stream, focal)
    return stream


class FramePose(NamedTuple):
    """A row of `poses.csv`."""

    stamp_ns: int
    segment: int
    world_from_cam0: Floats
    is_keyframe: bool


def poses_of(record: RunRecord) -> dict[int, FramePose]:
    """Poses of a run by number of the frame.

    Raises:
        SourceError: there is none, or the table is damaged.
    """
    path = record.path / "poses.csv"
    try:
        found = {
            int(row["frame"]): FramePose(
                int(row["stamp_ns"]),
                int(row["segment"]),
                make_transform(
                    rotation_from_quat_xyzw(np.array([float(row[f"q{a}"]) for a in "xyzw"])),
                    np.array([float(row[f"t{a}"]) for a in "xyz"]),
                ),
                row["keyframe"] == "1",
            )
            for row in table_rows(path, warn=False)
        }
    except (ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error
    if not found:
        raise SourceError(f"{path} has no pose; the run has no path")
    return found
