"""KITTI-360: a rectified pair ahead and two fisheyes to the sides, with poses of the GPS/INS unit.

A drive is a folder of `data_2d_raw`; calibrations and poses are beside that, in `calibration` and
`data_poses`. Source: Liao et al., KITTI-360, 2022.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vo.base.errors import CalibrationError, SourceError
from vo.base.files.bounded_files import read_text
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats, Mode, Trajectory
from vo.recordings.formats.calibration import Calibration, kitti, read_calibration
from vo.recordings.formats.calibration.checks import rig_of
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.formats.calibration.numbers import make_numbers
from vo.recordings.sources.assembly import RecordingContents
from vo.recordings.sources.listing import Shot, list_images, make_shots
from vo.recordings.sources.oxts import read_date_stamps

_FOLDERS = ("image_00/data_rect", "image_01/data_rect", "image_02/data_rgb", "image_03/data_rgb")
_MAX_POSES_BYTES = 2**26


def is_kitti_360(path: Path) -> bool:
    """Whether a folder has the images of such a drive."""
    return (path / _FOLDERS[0]).is_dir()


def gather_kitti_360(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a drive; cameras without images are left out from the end."""
    left, *others = [_shots(path / folder) for folder in _FOLDERS]
    if not left:
        raise SourceError(f"{path / _FOLDERS[0]} has no images")
    return RecordingContents(
        name=path.name,
        format="kitti_raw",
        left=left,
        right=others[0] or None,
        further=others[1:],
        calibrate=lambda size: (
            _calibration(path) if calibration is None else read_calibration(calibration, size)
        ),
        read_truth=lambda loaded: _truth(path, loaded),
    )


def _shots(folder: Path) -> list[Shot]:
    """The images of a camera, whose numbers are lines of `timestamps.txt`; some are missing."""
    if not folder.is_dir():
        return []
    images, table = list_images(folder), folder.parent / "timestamps.txt"
    stamps = read_date_stamps(table)
    rows = [int(image.stem) if image.stem.isdigit() else len(stamps) for image in images]
    if max(rows) >= len(stamps):
        raise SourceError(f"{folder} has image number {max(rows)}, but {table} {len(stamps)} lines")
    return make_shots([stamps[row] for row in rows], images, [f"{table}:{row + 1}" for row in rows])


def _calibration(path: Path) -> Calibration:
    """The cameras; the body is the GPS/INS unit."""
    folder = _shared(path, "calibration")
    if folder is None:
        raise CalibrationError(
            f"no folder calibration beside {path} or two above it; KITTI-360 has it as a file of "
            "its own to download (or give `calibration=FILE`)"
        )
    poses = _poses_on_body(folder / "calib_cam_to_pose.txt")
    rectified = folder / "perspective.txt"
    pair = kitti.read_raw(load_document(rectified), None, ("00", "01")).rig
    cameras: list[Camera] = [*pair.cameras]
    # Poses are those of the cameras before rectification, which turns both to the same axes.
    turn = kitti.rectification(load_document(rectified))
    body_from_cams = [poses["image_00"] @ inverse(turn)]
    body_from_cams += [body_from_cams[0] @ pose for pose in pair.cam0_from_cams[1:]]
    for name in ("image_02", "image_03"):
        file = folder / f"{name}.yaml"
        if not file.is_file():
            break
        cameras.append(read_calibration(file).rig.cam0)
        body_from_cams.append(poses[name])
    cam0_from_cams = [inverse(body_from_cams[0]) @ pose for pose in body_from_cams]
    rig = rig_of(str(folder), cameras, cam0_from_cams)
    return Calibration(rig, body_from_cams[0], kind="KITTI-360", file=rectified)


def _poses_on_body(file: Path) -> dict[str, Floats]:
    """Lines such as `image_00: ` and 12 numbers."""
    found = {}
    for line in load_document(file).text.splitlines():
        name, colon, numbers = line.partition(":")
        if colon:
            rows = make_numbers(f"{file}: {name}", numbers.split(), 12)
            pose = np.array(rows).reshape(3, 4)
            found[name.strip()] = make_transform(pose[:, :3], pose[:, 3])
    missing = [n for n in ("image_00", "image_02", "image_03") if n not in found]
    if missing:
        raise CalibrationError(f"{file}: {missing[0]} is missing; it is followed by 12 numbers")
    return found


def _truth(path: Path, calibration: Calibration) -> Trajectory | None:
    """Poses of cam0, from those of the unit at some frames."""
    folder = _shared(path, "data_poses")
    file = None if folder is None else folder / path.name / "poses.txt"
    if file is None or not file.is_file() or calibration.body_from_cam0 is None:
        return None
    stamps = read_date_stamps(path / "image_00" / "timestamps.txt")
    rows = [line.split() for line in read_text(file, _MAX_POSES_BYTES).splitlines() if line.strip()]
    if any(len(row) != 13 for row in rows):
        raise SourceError(f"{file}: lines have the number of a frame and 12 numbers")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.array([row[1:] for row in rows], np.float64).reshape(-1, 3, 4)
    times = np.array([stamps[int(row[0])] for row in rows if int(row[0]) < len(stamps)], np.int64)
    world_from_cam = poses[: len(times)] @ calibration.body_from_cam0
    return Trajectory(times, world_from_cam)


def _shared(path: Path, name: str) -> Path | None:
    """A folder in the drive, beside it or above, where the data set has it."""
    found = (folder / name for folder in (path, *path.parents[:2]))
    return next((each for each in found if each.is_dir()), None)
