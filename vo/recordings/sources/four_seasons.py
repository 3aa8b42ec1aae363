"""4Seasons: undistorted_images/cam0 and cam1, times.txt, GNSSPoses.txt, and calibration/ beside it.

Source: Wenzel et al., "4Seasons: a cross-season dataset for multi-weather SLAM in autonomous
driving", GCPR 2020, and the documentation of the data set.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Floats, Mode, Rig, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize, read_calibration
from vo.recordings.formats.calibration.checks import check_baseline
from vo.recordings.formats.calibration.numbers import make_transform
from vo.recordings.formats.table import read_table
from vo.recordings.formats.trajectory import read_four_seasons
from vo.recordings.sources.assembly import RecordingContents
from vo.recordings.sources.listing import Shot, list_images, shots_from_names

_IMAGES = "undistorted_images"
_CALIBRATION_FOLDERS = ("calibration", "Calibration")


def gather_four_seasons(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a recording; right images and GNSSPoses.txt are optional.

    Stamps are the names of the images, in nanoseconds. The calibration is that of the undistorted
    images, in a folder `calibration` of the recording or of a folder above it.
    """
    path = path.resolve()
    right = path / _IMAGES / "cam1"
    return RecordingContents(
        name=path.name,
        format="4seasons",
        left=_shots(path / _IMAGES / "cam0"),
        right=_shots(right) if right.is_dir() else None,
        calibrate=lambda size: (
            _calibration(path, size) if calibration is None else read_calibration(calibration, size)
        ),
        read_truth=lambda _: _truth(path / "GNSSPoses.txt"),
    )


def _shots(folder: Path) -> list[Shot]:
    shots = shots_from_names(list_images(folder))
    if shots is None:
        raise SourceError(f"the names of the images in {folder} are not stamps in nanoseconds")
    return shots


def _calibration(path: Path, size: ImageSize) -> Calibration:
    """The cameras of the undistorted images, and the transform between them."""
    above = (path, path.parent, path.parent.parent)
    folders = [folder / name for folder in above for name in _CALIBRATION_FOLDERS]
    left = next((f / "undistorted_calib_0.txt" for f in folders if f.is_dir()), None)
    if left is None:
        raise CalibrationError(
            f"no calibration found; looked for a folder `calibration` in {path} and two "
            "folders above it; it is a download of its own"
        )
    found = read_calibration(left, size)
    right, stereo = (left.with_name(f"undistorted_calib_{name}.txt") for name in ("1", "stereo"))
    if not right.is_file() or not stereo.is_file():
        return found
    cam1 = read_calibration(right, size).rig.cam0
    return replace(found, rig=Rig(found.rig.cam0, cam1, _transform(stereo)))


def _transform(file: Path) -> Floats:
    """`cam1_from_cam0` (4, 4) of `undistorted_calib_stereo.txt`."""
    try:
        rows = [[float(field) for field in line.fields] for line in read_table(file)]
    except (SourceError, ValueError) as error:
        raise CalibrationError(f"{file} is not a matrix of four columns: {error}") from error
    transform = make_transform(str(file), rows)
    check_baseline(str(file), transform)
    return transform


def _truth(file: Path) -> Trajectory | None:
    return read_four_seasons(file) if file.is_file() else None
