"""KITTI odometry: image_0/ image_1/ calib.txt times.txt, or colour image_2/ image_3/.

Ground truth is `poses.txt` in the sequence, or `poses/NN.txt` beside `sequences/NN` as distributed.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.types import Mode, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize, kitti, read_calibration
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.formats.trajectory import read_kitti
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, first_existing
from vo.recordings.sources.listing import Shot, camera_folders, list_images, shots_from_times
from vo.recordings.sources.pairing import copy_stamps

_log = logging.getLogger(__name__)

_PAIRS = {("image_0", "image_1"): ("P0", "P1"), ("image_2", "image_3"): ("P2", "P3")}


def gather_kitti(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a sequence; right images, calib.txt and poses are optional."""
    folders, matrices = next(
        (pair for pair in _PAIRS.items() if (path / pair[0][0]).is_dir()),
        (("image_0", "image_1"), ("P0", "P1")),
    )
    faults: list[Fault] = []
    left = shots_from_times(path / "times.txt", list_images(path / folders[0]), faults)
    # calib.txt has a pair: image_2 and image_3 are the same in colour.
    is_pair = folders[0] != "image_0" or (calibration is None and (path / "calib.txt").is_file())
    further = [] if is_pair else camera_folders(path, "image_{}")[2:]
    return RecordingContents(
        name=path.resolve().name,
        format="kitti",
        left=left,
        right=_right(path / folders[1], left),
        further=[_right(folder, left) for folder in further],
        calibrate=lambda size: _calibration(path, calibration, matrices, size),
        read_truth=lambda loaded: _truth(_poses_file(path), left, loaded),
        faults=faults,
    )


def _right(folder: Path, left: list[Shot]) -> list[Shot] | None:
    try:
        images = list_images(folder)
    except SourceError:
        return None
    return copy_stamps(left, images)


def _calibration(
    path: Path, chosen: Path | None, matrices: tuple[str, str], size: ImageSize
) -> Calibration:
    file = path / "calib.txt"
    if chosen is None and file.is_file():
        document = load_document(file)
        if kitti.recognises(document):
            return replace(kitti.read(document, size, matrices), kind="KITTI", file=file)
        return read_calibration(file, size)
    return calibration_reader(chosen, [file, path / "calibration.yaml"])(size)


def _poses_file(path: Path) -> Path | None:
    folder = path.resolve()
    return first_existing(
        [folder / "poses.txt", folder.parent.parent / "poses" / f"{folder.name}.txt"]
    )


def _truth(poses: Path | None, left: list[Shot], calibration: Calibration) -> Trajectory | None:
    """Poses of the left camera in use; those in the file belong to KITTI's grey left camera."""
    if poses is None:
        return None
    rows = read_kitti(poses).world_from_cam
    count = min(len(rows), len(left))
    if len(rows) != len(left):
        _log.warning(
            "%s has %d poses for %d images; the first %d are used",
            poses,
            len(rows),
            len(left),
            count,
        )
    stamps_ns = np.array([shot.stamp_ns for shot in left[:count]], dtype=np.int64)
    body_from_cam0 = calibration.body_from_cam0
    world_from_cam = rows[:count] if body_from_cam0 is None else rows[:count] @ body_from_cam0
    return Trajectory(stamps_ns, world_from_cam)
