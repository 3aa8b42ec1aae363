"""GPS/INS records of KITTI raw (oxts): ground-truth poses and inertial samples."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_text
from vo.base.geometry.transforms import interpolate, orthonormalised
from vo.base.geometry.transforms import make_transform as rigid
from vo.base.types import Floats, Ints, Trajectory
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.formats.calibration.numbers import make_numbers, make_transform
from vo.recordings.formats.positions import PositionTable
from vo.recordings.formats.stamp_units import StampText, parse_stamps
from vo.recordings.sources.imu import ImuSamples, make_samples
from vo.recordings.sources.listing import read_lines

_log = logging.getLogger(__name__)

_MAX_RECORD_BYTES = 2**20
_EARTH_RADIUS_M = 6378137.0
_ACCELERATIONS = slice(11, 14)  # ax, ay, az along the axes of the unit, in m/s^2, with gravity
_RATES = slice(17, 20)  # wx, wy, wz about them, in rad/s
_COLUMNS = 6  # latitude and longitude in degrees, altitude in metres, roll, pitch, yaw in radians


def read_oxts(folder: Path, stamps_ns: Sequence[int]) -> Trajectory:
    """Read `data/*.txt`, one record per file, as world_from_imu; x east, y north, z up.

    The origin of the world is the first record. Records whose stamp does not increase are skipped.

    Source: Geiger et al., Vision meets Robotics: The KITTI Dataset, IJRR 2013 (Mercator projection
        at the latitude of the first record).
    """
    files = _files(folder, stamps_ns)
    stamps = np.array(stamps_ns, dtype=np.int64)
    is_later = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
    records = np.array([_record(path) for path in files])[is_later]
    positions = mercator(records[:, :3], float(records[0, 0]))
    poses = [
        rigid(rotation_from_roll_pitch_yaw(*record[3:]), position)
        for record, position in zip(records, positions - positions[0], strict=True)
    ]
    return Trajectory(stamps[is_later], np.stack(poses))


def read_oxts_positions(folder: Path) -> PositionTable:
    """Read the positions alone, with the stamps in `timestamps.txt`."""
    stamps_ns = np.array(read_date_stamps(folder / "timestamps.txt"), dtype=np.int64)
    values = np.array([_record(path)[:3] for path in _files(folder, stamps_ns.tolist())])
    unique, rows = np.unique(stamps_ns, return_index=True)
    return PositionTable(unique, values[rows], np.full(len(rows), np.nan), is_geodetic=True)


def read_date_stamps(table: Path) -> list[int]:
    """Stamps in nanoseconds of lines such as `2011-09-26 13:02:25.964389445`."""
    lines = [StampText(location, text) for location, text in read_lines(table)]
    return parse_stamps(lines, "s")


def read_oxts_imu(folder: Path, stamps_ns: Sequence[int]) -> ImuSamples:
    """Read angular rates and accelerations from `data/*.txt`; x forward, y left, z up.

    These are the values in the frame of the unit (ax, ay, az and wx, wy, wz), not those in its
    levelled frame (af, al, au and wf, wl, wu). Arguments as for `read_oxts`.
    """
    stamps, values, files = [], [], _files(folder, stamps_ns)
    for path, stamp_ns in zip(files, stamps_ns, strict=True):
        try:
            numbers = [float(field) for field in read_text(path, _MAX_RECORD_BYTES).split()]
        except (OSError, ValueError):
            continue
        if len(numbers) >= _RATES.stop:
            stamps.append(stamp_ns)
            values.append([*numbers[_RATES], *numbers[_ACCELERATIONS]])
    read = make_samples(stamps, values, len(files) - len(stamps))
    if read.unreadable:
        _log.warning(
            "%s: %d of %d records have no readable rates and accelerations",
            folder,
            read.unreadable,
            len(files),
        )
    return read


def _files(folder: Path, stamps_ns: Sequence[int]) -> list[Path]:
    files = sorted((folder / "data").glob("*.txt"))
    if len(files) != len(stamps_ns) or not files:
        raise SourceError(
            f"{folder} has {len(files)} records but {len(stamps_ns)} stamps; both numbers must be "
            "equal"
        )
    return files


def mercator(geodetic: Floats, reference_latitude_deg: float) -> Floats:
    """Mercator projection to metres east, north and up (N, 3).

    Args:
        geodetic: (N, 3) latitude and longitude in degrees, altitude in metres.
        reference_latitude_deg: latitude of true scale.
    """
    scale = np.cos(np.deg2rad(reference_latitude_deg)) * _EARTH_RADIUS_M
    latitude, longitude = np.deg2rad(geodetic[:, 0]), np.deg2rad(geodetic[:, 1])
    north = np.log(np.tan(0.25 * np.pi + 0.5 * latitude))
    return np.column_stack([scale * longitude, scale * north, geodetic[:, 2]])


def rotation_from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Floats:
    """world_from_body (3, 3) = Rz(yaw) Ry(pitch) Rx(roll), angles in radians."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def read_transform(path: Path) -> Floats:
    """Read a (4, 4) transform from lines `R: …` and `T: …`, as in calib_velo_to_cam.txt."""
    lines = dict(
        line.split(":", 1) for line in load_document(path).text.splitlines() if ":" in line
    )
    rotation = make_numbers(f"{path}: R", lines.get("R", "").split(), 9)
    shift = make_numbers(f"{path}: T", lines.get("T", "").split(), 3)
    rows = [[*rotation[3 * i : 3 * i + 3], shift[i]] for i in range(3)]
    return orthonormalised(make_transform(str(path), rows))


def interpolate_at(truth: Trajectory, stamps_ns: Ints) -> Trajectory:
    """Interpolate poses at other times; times outside the trajectory are skipped."""
    inside = (stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])
    times_ns = stamps_ns[inside]
    after = np.searchsorted(truth.stamps_ns, times_ns).clip(1, max(len(truth) - 1, 1))
    poses = [
        _interpolate(truth, int(row), int(stamp))
        for row, stamp in zip(after, times_ns, strict=True)
    ]
    return Trajectory(times_ns, np.array(poses).reshape(-1, 4, 4))


def _interpolate(truth: Trajectory, after: int, stamp_ns: int) -> Floats:
    first, last = int(truth.stamps_ns[after - 1]), int(truth.stamps_ns[min(after, len(truth) - 1)])
    if stamp_ns == first or last == first:
        return np.asarray(truth.world_from_cam[after - 1])
    ratio = (stamp_ns - first) / (last - first)
    return interpolate(truth.world_from_cam[after - 1], truth.world_from_cam[after], ratio)


def _record(path: Path) -> list[float]:
    try:
        fields = read_text(path, _MAX_RECORD_BYTES).split()
        values = [float(field) for field in fields[:_COLUMNS]]
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read: {error}") from error
    if len(values) < _COLUMNS or not np.isfinite(values).all() or abs(values[0]) >= 90.0:
        raise SourceError(
            f"{path} is not a GPS/INS record; it must begin with latitude, longitude, altitude, "
            "roll, pitch and yaw"
        )
    return values
