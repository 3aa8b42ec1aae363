"""EuRoC MAV layout: cam0/data.csv and cam0/data/, with or without a parent folder mav0/."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from vo.base.errors import CalibrationError, SourceError, VoError
from vo.base.faults import Fault
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, ImuNoise, Mode, Trajectory
from vo.recordings.formats.calibration import Calibration
from vo.recordings.formats.calibration.checks import make_noise
from vo.recordings.formats.calibration.document import Document, load_document
from vo.recordings.formats.calibration.kalibr import NOISE_KEYS
from vo.recordings.formats.calibration.numbers import make_transform
from vo.recordings.formats.euroc_layout import (
    calibration_files,
    find_camera_on_body,
    recording_folder,
)
from vo.recordings.formats.trajectory import read_euroc, read_tum
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, first_existing
from vo.recordings.sources.folder import find_times_file
from vo.recordings.sources.imu import FileImu, imu_of
from vo.recordings.sources.imu_table import read_imu_table
from vo.recordings.sources.listing import (
    Shot,
    camera_folders,
    list_images,
    shots_from_names,
    shots_from_table,
    shots_from_times,
)
from vo.recordings.sources.pairing import copy_stamps

_TRUTH_FOLDERS = ("state_groundtruth_estimate0", "mocap0", "gt0")
_log = logging.getLogger(__name__)
_Load = Callable[[Path], Document]


def gather_euroc(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a recording, given its folder or the folder mav0 in it."""
    path = path.resolve()
    root = path / "mav0" if (path / "mav0").is_dir() else path
    top = recording_folder(root)
    faults: list[Fault] = []
    left = _shots(root / "cam0", faults)
    others = [_other_shots(folder, left) for folder in camera_folders(root, "cam{}")[1:]]
    return RecordingContents(
        name=top.name,
        format="euroc",
        left=left,
        right=others[0] if others else None,
        further=others[1:],
        calibrate=calibration_reader(calibration, calibration_files(root)),
        read_truth=lambda loaded: _truth(root, top, loaded),
        find_imus=lambda loaded: euroc_imus(root, loaded, lambda: _body_from_cam0(root, loaded)),
        faults=faults,
    )


def _shots(camera: Path, faults: list[Fault] | None = None) -> list[Shot]:
    table, folder = camera / "data.csv", camera / "data"
    if table.is_file():
        return shots_from_table(table, folder, ",", "ns", faults)
    if not folder.is_dir() and (times := find_times_file(camera, camera.parent)) is not None:
        return shots_from_times(times, list_images(camera), faults)
    folder = folder if folder.is_dir() else camera
    shots = shots_from_names(list_images(folder))
    if shots is None:
        raise SourceError(
            f"{table} is missing, there is no times.txt in {camera} or beside it, and the file "
            f"names in {folder} are not stamps"
        )
    return shots


def _other_shots(camera: Path, left: list[Shot]) -> list[Shot] | None:
    """The images of a camera beside cam0, with its own stamps, or those of cam0 by name."""
    if not camera.is_dir():
        return None
    is_plain = not (camera / "data").is_dir() and not (camera / "data.csv").is_file()
    if is_plain and find_times_file(camera) is None:
        images = list_images(camera)
        return shots_from_names(images) or copy_stamps(left, images)
    return _shots(camera)


def _truth(root: Path, top: Path, calibration: Calibration) -> Trajectory | None:
    """Poses of the body transformed to cam0, or else `groundtruth.tum`, poses of cam0."""
    body = first_existing([root / folder / "data.csv" for folder in _TRUTH_FOLDERS])
    body_from_cam0 = _body_from_cam0(root, calibration)
    if body is not None and body_from_cam0 is not None:
        truth = read_euroc(body)
        return replace(truth, world_from_cam=truth.world_from_cam @ body_from_cam0)
    camera = first_existing([top / "groundtruth.tum", root / "groundtruth.tum"])
    if camera is not None:
        return read_tum(camera)
    if body is not None:
        raise SourceError(
            f"{body} has poses of the body, but no calibration contains cam0's pose on the body"
        )
    return None


def _body_from_cam0(root: Path, calibration: Calibration | None) -> Floats | None:
    try:
        found = find_camera_on_body(root, calibration)
    except CalibrationError:
        return None
    return None if found is None else found.body_from_cam0


def euroc_imus(
    root: Path,
    calibration: Calibration | None,
    body_from_cam0: Callable[[], Floats | None],
    tables: Sequence[Path] = (),
) -> list[FileImu]:
    """The inertial sensors of a recording; their files are read on first use.

    `tables`: their files; by default all `imu*/data.csv`.
    """
    tables = tables or sorted(root.glob("imu*/data.csv"))
    return [_imu(table, calibration, body_from_cam0) for table in tables]


def _imu(
    table: Path, calibration: Calibration | None, body_from_cam0: Callable[[], Floats | None]
) -> FileImu:
    sensor = table.parent / "sensor.yaml"

    given, load = imu_of(calibration), cache(load_document)

    def find_extrinsics() -> Floats | None:
        if given.cam0_from_imu is not None:
            return given.cam0_from_imu
        body_from_imu, body_from_cam = _body_from_imu(sensor, load), body_from_cam0()
        if body_from_imu is None or body_from_cam is None:
            return None
        return inverse(body_from_cam) @ body_from_imu

    return FileImu(
        str(table),
        lambda: read_imu_table(table),
        find_extrinsics,
        lambda: given.noise or _noise(sensor, load),
        given.time_offset_s,
    )


def _body_from_imu(sensor: Path, load: _Load) -> Floats | None:
    if not sensor.is_file():
        return None
    try:
        data = load(sensor).data
        return make_transform(f"{sensor}: T_BS", data["T_BS"]) if "T_BS" in data else None
    except VoError as error:
        _log.warning("pose of the inertial sensor unknown: %s", error)
        return None


def _noise(sensor: Path, load: _Load) -> ImuNoise | None:
    if not sensor.is_file():
        return None
    try:
        return make_noise(str(sensor), load(sensor).data, NOISE_KEYS)
    except VoError as error:
        _log.warning("noise of the inertial sensor unknown: %s", error)
        return None
