"""KITTI raw: a drive with image_00/data/ and timestamps.txt, calibrated by calib_cam_to_cam.txt."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError, VoError
from vo.base.geometry.transforms import inverse
from vo.base.noise_classes import NOISE_CLASSES
from vo.base.types import Floats, Mode, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize, kitti
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, first_existing
from vo.recordings.sources.imu import FileImu, ImuSamples, imu_of
from vo.recordings.sources.kitti_360 import gather_kitti_360, is_kitti_360
from vo.recordings.sources.listing import Shot, list_images, make_shots
from vo.recordings.sources.oxts import (
    interpolate_at,
    read_date_stamps,
    read_oxts,
    read_oxts_imu,
    read_transform,
)

_log = logging.getLogger(__name__)

_PAIRS = (("image_00", "image_01"), ("image_02", "image_03"))
_CALIBRATION = "calib_cam_to_cam.txt"


def gather_kitti_raw(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a drive, rectified (`sync`) or as recorded (`extract`); prefer the grey cameras."""
    path = path.resolve()
    if is_kitti_360(path):
        return gather_kitti_360(path, calibration, mode)
    left, right = next((pair for pair in _PAIRS if (path / pair[0]).is_dir()), _PAIRS[0])
    cameras = (left[-2:], right[-2:])
    shots = _shots(path / left)
    return RecordingContents(
        name=path.name,
        format="kitti_raw",
        left=shots,
        right=_shots(path / right) if (path / right / "data").is_dir() else None,
        calibrate=lambda size: _calibration(path, calibration, cameras, size),
        read_truth=lambda loaded: _truth(path, loaded, cameras, shots),
        find_imus=lambda loaded: _imus(path, loaded, cameras),
    )


def _shots(camera: Path) -> list[Shot]:
    """The images of a camera; if some are missing, their numbers are the line numbers."""
    images = list_images(camera / "data")
    stamps = read_date_stamps(camera / "timestamps.txt")
    if len(images) == len(stamps):
        rows = list(range(len(images)))
    else:
        rows = [int(image.stem) if image.stem.isdigit() else len(stamps) for image in images]
        if max(rows) >= len(stamps):
            raise SourceError(
                f"{camera} has {len(images)} images but {len(stamps)} stamps, and the image names "
                "are not line numbers; there must be one line per image"
            )
    table = str(camera / "timestamps.txt")
    return make_shots([stamps[row] for row in rows], images, [f"{table}:{row + 1}" for row in rows])


def _calibration(
    path: Path, chosen: Path | None, cameras: tuple[str, str], size: ImageSize
) -> Calibration:
    candidates = [path / _CALIBRATION, path.parent / _CALIBRATION, path / "calibration.yaml"]
    file = chosen or first_existing(candidates)
    if file is not None:
        document = load_document(file)
        if kitti.recognises_raw(document):
            found = kitti.read_raw(document, size, cameras)
            return replace(found, kind="KITTI raw", file=file)
    return calibration_reader(chosen, candidates)(size)


def _truth(
    path: Path, calibration: Calibration, cameras: tuple[str, str], shots: Sequence[Shot]
) -> Trajectory | None:
    """Poses of cam0 at the stamps of its images, interpolated from those of the GPS/INS unit."""
    folder = path / "oxts"
    if not folder.is_dir():
        return None
    imu_from_cam0 = _imu_from_cam0(path, calibration, cameras)
    truth = read_oxts(folder, read_date_stamps(folder / "timestamps.txt"))
    truth = replace(truth, world_from_cam=truth.world_from_cam @ imu_from_cam0)
    stamps_ns = np.array([shot.stamp_ns for shot in shots], dtype=np.int64)
    return interpolate_at(truth, stamps_ns)


def _imus(path: Path, calibration: Calibration | None, cameras: tuple[str, str]) -> list[FileImu]:
    """The GPS/INS unit as an inertial sensor."""
    folder = path / "oxts"
    if not folder.is_dir():
        return []

    given = imu_of(calibration)

    def find_extrinsics() -> Floats | None:
        if given.cam0_from_imu is not None or calibration is None:
            return given.cam0_from_imu
        try:
            return inverse(_imu_from_cam0(path, calibration, cameras))
        except VoError as error:
            _log.warning("pose of the inertial sensor unknown: %s", error)
            return None

    def load() -> ImuSamples:
        return read_oxts_imu(folder, read_date_stamps(folder / "timestamps.txt"))

    noise = given.noise or NOISE_CLASSES["tactical"]
    return [FileImu(str(folder), load, find_extrinsics, lambda: noise, given.time_offset_s)]


def _imu_from_cam0(path: Path, calibration: Calibration, cameras: tuple[str, str]) -> Floats:
    velo_from_imu = read_transform(_beside(path, "calib_imu_to_velo.txt"))
    body_from_velo = read_transform(_beside(path, "calib_velo_to_cam.txt"))
    body_from_cam0 = calibration.body_from_cam0
    if body_from_cam0 is None:  # optional in a calibration chosen by the user
        size = (calibration.rig.cam0.width, calibration.rig.cam0.height)
        document = load_document(_beside(path, _CALIBRATION))
        body_from_cam0 = kitti.read_raw(document, size, cameras).body_from_cam0
    assert body_from_cam0 is not None
    return inverse(body_from_velo @ velo_from_imu) @ body_from_cam0


def _beside(path: Path, name: str) -> Path:
    """A file of the drive, or else the file shared by all drives of its date."""
    return first_existing([path / name]) or path.parent / name
