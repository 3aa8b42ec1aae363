"""KITTI's GPS/INS records (oxts): where the camera truly was, rates and accelerations."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo.errors import SourceError
from vo.formats.calibration.checks import make_numbers, make_transform
from vo.formats.calibration.document import load_document
from vo.geometry.transforms import interpolate, orthonormalised
from vo.geometry.transforms import make_transform as rigid
from vo.sources.imu import ImuSamples, make_samples
from vo.types import Floats, Ints, Trajectory

_log = logging.getLogger(__name__)

_EARTH_RADIUS_M = 6378137.0
_ACCELERATIONS = slice(11, 14)  # ax, ay, az along the axes of the unit, in m/s^2, with gravity
_RATES = slice(17, 20)  # wx, wy, wz about them, in rad/s
_COLUMNS = 6  # latitude and longitude in degrees, altitude in metres, roll, pitch, yaw in radians


def read_oxts(folder: Path, stamps_ns: Sequence[int]) -> Trajectory:
    """Read `data/*.txt`, one record a file, as world_from_imu; x east, y north, z up.

    The world begins at the first record. Records whose time does not go on are left out.

    Args:
        folder: of the records.
        stamps_ns: time of each.

    Raises:
        SourceError: records are missing, damaged or not as many as stamps.

    Source: Geiger et al., Vision meets Robotics: The KITTI Dataset, IJRR 2013 (Mercator projection
        at the latitude of the first record).
    """
    files = _files(folder, stamps_ns)
    stamps = np.array(stamps_ns, dtype=np.int64)
    goes_on = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
    records = np.array([_record(path) for path in files])[goes_on]
    positions = mercator(records[:, :3], float(records[0, 0]))
    poses = [
        rigid(rotation_from_roll_pitch_yaw(*record[3:]), position)
        for record, position in zip(records, positions - positions[0], strict=True)
    ]
    return Trajectory(stamps[goes_on], np.stack(poses))


def read_oxts_imu(folder: Path, stamps_ns: Sequence[int]) -> ImuSamples:
    """Rates and accelerations of `data/*.txt` along the axes of the unit: x ahead, y left, z up.

    Of the two sets that a record has, this is the one that turns with the unit (ax, ay, az and wx,
    wy, wz); the other one (af, al, au and wf, wl, wu) stays level. Arguments as of `read_oxts`.

    Raises:
        SourceError: there are not as many records as stamps.
    """
    stamps, values, files = [], [], _files(folder, stamps_ns)
    for path, stamp_ns in zip(files, stamps_ns, strict=True):
        try:
            numbers = [float(field) for field in path.read_text(encoding="utf-8").split()]
        except (OSError, ValueError):
            continue
        if len(numbers) >= _RATES.stop:
            stamps.append(stamp_ns)
            values.append([*numbers[_RATES], *numbers[_ACCELERATIONS]])
    read = make_samples(stamps, values, len(files) - len(stamps))
    if read.unreadable:
        _log.warning(
            "%s: %d of %d records have no rates and accelerations that can be read",
            folder,
            read.unreadable,
            len(files),
        )
    return read


def _files(folder: Path, stamps_ns: Sequence[int]) -> list[Path]:
    files = sorted((folder / "data").glob("*.txt"))
    if len(files) != len(stamps_ns) or not files:
        raise SourceError(
            f"{folder} has {len(files)} records but {len(stamps_ns)} stamps; there must be as many"
        )
    return files


def mercator(geodetic: Floats, reference_latitude_deg: float) -> Floats:
    """Metres east, north and up (N, 3) of latitude, longitude (degrees) and altitude (N, 3)."""
    scale = np.cos(np.deg2rad(reference_latitude_deg)) * _EARTH_RADIUS_M
    latitude, longitude = np.deg2rad(geodetic[:, 0]), np.deg2rad(geodetic[:, 1])
    north = np.log(np.tan(0.25 * np.pi + 0.5 * latitude))
    return np.column_stack([scale * longitude, scale * north, geodetic[:, 2]])


def rotation_from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Floats:
    """Rz(yaw) Ry(pitch) Rx(roll) as (3, 3): from the body to the world."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def read_rigid(path: Path) -> Floats:
    """The (4, 4) transform of a file with lines `R: …` and `T: …`, such as calib_velo_to_cam.txt.

    Raises:
        CalibrationError: the file is missing or damaged.
    """
    lines = dict(
        line.split(":", 1) for line in load_document(path).text.splitlines() if ":" in line
    )
    rotation = make_numbers(f"{path}: R", lines.get("R", "").split(), 9)
    shift = make_numbers(f"{path}: T", lines.get("T", "").split(), 3)
    rows = [[*rotation[3 * i : 3 * i + 3], shift[i]] for i in range(3)]
    return orthonormalised(make_transform(str(path), rows))


def at_stamps(truth: Trajectory, stamps_ns: Ints) -> Trajectory:
    """The poses at other times, between those that are known; times outside are left out."""
    inside = (stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])
    wanted = stamps_ns[inside]
    after = np.searchsorted(truth.stamps_ns, wanted).clip(1, max(len(truth) - 1, 1))
    poses = [
        _between(truth, int(row), int(stamp)) for row, stamp in zip(after, wanted, strict=True)
    ]
    return Trajectory(wanted, np.array(poses).reshape(-1, 4, 4))


def _between(truth: Trajectory, after: int, stamp_ns: int) -> Floats:
    first, last = int(truth.stamps_ns[after - 1]), int(truth.stamps_ns[min(after, len(truth) - 1)])
    if stamp_ns == first or last == first:
        return np.asarray(truth.world_from_cam[after - 1])
    share = (stamp_ns - first) / (last - first)
    return interpolate(truth.world_from_cam[after - 1], truth.world_from_cam[after], share)


def _record(path: Path) -> list[float]:
    try:
        fields = path.read_text(encoding="utf-8").split()
        values = [float(field) for field in fields[:_COLUMNS]]
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read: {error}") from error
    if len(values) < _COLUMNS or not np.isfinite(values).all() or abs(values[0]) >= 90.0:
        raise SourceError(
            f"{path} is no record; it must begin with latitude, longitude, altitude, roll, pitch "
            "and yaw"
        )
    return values
