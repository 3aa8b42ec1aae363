"""Trajectories as text: TUM, KITTI and EuRoC, with stamps that survive to the nanosecond."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Literal

import numpy as np

from vo.errors import OutputError, SourceError
from vo.formats.rows import Row, need_columns, numbers, read_rows
from vo.geometry.transforms import quat_xyzw_of_rows, rotation_from_quat_xyzw
from vo.types import Floats, Ints, Trajectory

TrajectoryFormat = Literal["tum", "kitti", "euroc"]

_log = logging.getLogger(__name__)
_NS_PER_S = 1_000_000_000
_MAX_S = 9_000_000_000
_TUM_COLUMNS = 8
_KITTI_COLUMNS = 12
_EUROC_COLUMNS = 8


def read_trajectory(path: Path | str) -> Trajectory:
    """Read a trajectory in whichever of the three formats the file's content shows.

    A KITTI file takes its stamps from a `times.txt` of the same length beside it; without one its
    rows are numbered as whole seconds.

    Raises:
        SourceError: the file is missing, empty, damaged or of none of the formats.
    """
    path = Path(path)
    kind = detect_format(path)
    if kind == "tum":
        return read_tum(path)
    if kind == "euroc":
        return read_euroc(path)
    return read_kitti(path, kitti_stamps_beside(path))


def detect_format(path: Path | str) -> TrajectoryFormat:
    """Name the format by the first line of data.

    Raises:
        SourceError: the file is missing, empty or of none of the formats.
    """
    first = read_rows(Path(path))[0]
    columns = len(first.fields)
    if first.has_commas and columns >= _EUROC_COLUMNS:
        return "euroc"
    if columns == _TUM_COLUMNS:
        return "tum"
    if columns == _KITTI_COLUMNS:
        return "kitti"
    raise SourceError(
        f"{first.place}: {columns} columns are no trajectory; TUM has 8 (stamp tx ty tz qx qy qz "
        "qw), KITTI 12 (a 3x4 matrix), EuRoC 8 or more with commas and stamps in nanoseconds"
    )


def read_tum(path: Path | str) -> Trajectory:
    """Read `stamp tx ty tz qx qy qz qw` lines, stamps in decimal seconds.

    Raises:
        SourceError: the file is missing, empty or damaged.
    """
    rows = read_rows(Path(path))
    need_columns(rows, _TUM_COLUMNS, exactly=True)
    stamps = _seconds_column(rows)
    values = numbers(rows, 1, _TUM_COLUMNS)
    return _trajectory(rows, stamps, values[:, :3], values[:, 3:7])


def read_euroc(path: Path | str) -> Trajectory:
    """Read a EuRoC ground truth CSV: `stamp_ns, x, y, z, qw, qx, qy, qz, …`.

    The poses are those of the body (the IMU), world_from_body, not of a camera.

    Raises:
        SourceError: the file is missing, empty or damaged.
    """
    rows = read_rows(Path(path))
    need_columns(rows, _EUROC_COLUMNS, exactly=False)
    stamps = [_whole_ns(row) for row in rows]
    values = numbers(rows, 1, _EUROC_COLUMNS)
    quat_xyzw = values[:, [4, 5, 6, 3]]
    return _trajectory(rows, np.array(stamps, dtype=np.int64), values[:, :3], quat_xyzw)


def read_kitti(path: Path | str, stamps_ns: Ints | None = None) -> Trajectory:
    """Read rows of twelve numbers, each a 3x4 world_from_cam0 row by row.

    Rotations are kept as written, to the seven digits that KITTI gives.

    Args:
        path: the file.
        stamps_ns: (N,) time of each row; without them row i gets i whole seconds.

    Raises:
        SourceError: the file is missing, empty, damaged or has another number of rows than stamps.
    """
    rows = read_rows(Path(path))
    need_columns(rows, _KITTI_COLUMNS, exactly=True)
    values = numbers(rows, 0, _KITTI_COLUMNS)
    _need_poses(rows, values)
    if stamps_ns is None:
        stamps_ns = np.arange(len(rows), dtype=np.int64) * _NS_PER_S
    if len(stamps_ns) != len(rows):
        raise SourceError(f"{path}: {len(rows)} poses but {len(stamps_ns)} stamps; give as many")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :] = values.reshape(-1, 3, 4)
    _need_rotations(rows, poses[:, :3, :3])
    return _with_increasing_stamps(rows, stamps_ns, poses)


def read_kitti_times(path: Path | str) -> Ints:
    """Read a KITTI `times.txt`, one stamp in seconds a line, as (N,) nanoseconds.

    Raises:
        SourceError: the file is missing, empty or damaged.
    """
    rows = read_rows(Path(path))
    need_columns(rows, 1, exactly=True)
    return _seconds_column(rows)


def kitti_stamps_beside(path: Path | str) -> Ints | None:
    """The stamps in `times.txt` beside a KITTI pose file, or None where there is none that fits."""
    times = Path(path).with_name("times.txt")
    if not times.is_file():
        return None
    stamps_ns = read_kitti_times(times)
    count = len(read_rows(Path(path)))
    if len(stamps_ns) != count:
        _log.warning("%s has %d stamps for %d poses: not used", times, len(stamps_ns), count)
        return None
    return stamps_ns


def stamp_ns_from_seconds(text: str) -> int:
    """Nanoseconds of seconds written as decimal text, exact to the ninth decimal.

    Raises:
        ValueError: the text is not a number, or too large for 64 bits of nanoseconds.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation as error:
        raise ValueError(f"'{text}' is not a number of seconds") from error
    if not seconds.is_finite() or not -_MAX_S <= seconds <= _MAX_S:
        raise ValueError(f"{text} is out of range for seconds")
    return int((seconds * _NS_PER_S).to_integral_value())


def tum_line(stamp_ns: int, world_from_cam: Floats) -> str:
    """One line `stamp tx ty tz qx qy qz qw`, without line end, the stamp to the nanosecond."""
    return tum_line_of_fields(stamp_ns, pose_fields(world_from_cam))


def tum_line_of_fields(stamp_ns: int, fields: Sequence[str]) -> str:
    """The same of what `pose_fields` made of the pose."""
    seconds, nanoseconds = divmod(abs(int(stamp_ns)), _NS_PER_S)
    sign = "-" if stamp_ns < 0 else ""
    return f"{sign}{seconds}.{nanoseconds:09d} {' '.join(fields)}"


def pose_fields(world_from_cam: Floats) -> list[str]:
    """The digits of `tx ty tz qx qy qz qw`."""
    rows = world_from_cam[:3].tolist()
    quat_xyzw = quat_xyzw_of_rows(rows)
    if quat_xyzw[3] < 0:
        quat_xyzw = [-q for q in quat_xyzw]
    return [f"{value:z.9f}" for value in (*(row[3] for row in rows), *quat_xyzw)]


def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM text.

    Raises:
        OutputError: the file cannot be written.
    """
    pairs = zip(trajectory.stamps_ns, trajectory.world_from_cam, strict=True)
    text = "".join(f"{tum_line(int(stamp), pose)}\n" for stamp, pose in pairs)
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


def _seconds_column(rows: list[Row]) -> Ints:
    stamps = []
    for row in rows:
        try:
            stamps.append(stamp_ns_from_seconds(row.fields[0]))
        except ValueError as error:
            raise SourceError(f"{row.place}: {error}; write stamps like 12.345678901") from error
    return np.array(stamps, dtype=np.int64)


def _whole_ns(row: Row) -> int:
    text = row.fields[0]
    if not text.lstrip("-").isdecimal() or len(text) > len(str(_MAX_S * _NS_PER_S)):
        raise SourceError(f"{row.place}: stamp '{text}' is not a whole number of nanoseconds")
    return int(text)


def _trajectory(rows: list[Row], stamps_ns: Ints, xyz: Floats, quat_xyzw: Floats) -> Trajectory:
    """A trajectory from positions (N, 3) and quaternions (N, 4) of any length.

    What motion capture writes where it saw nothing, NaN or quaternions of zero, is left out.
    """
    finite = np.isfinite(xyz).all(axis=1) & np.isfinite(quat_xyzw).all(axis=1)
    known = finite & (np.linalg.norm(quat_xyzw, axis=1) >= 1e-6)
    unknown = np.flatnonzero(~known)
    if len(unknown):
        told = f"{len(unknown)} of {len(rows)} lines are no pose (NaN, or a quaternion of zero)"
        first = rows[unknown[0]].place
        if len(unknown) == len(rows):
            raise SourceError(f"{first}: {told}; give a trajectory with at least one pose")
        _log.warning("%s: %s and are left out; the first is this", first, told)
    rows = [rows[i] for i in np.flatnonzero(known)]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = rotation_from_quat_xyzw(quat_xyzw[known])
    poses[:, :3, 3] = xyz[known]
    return _with_increasing_stamps(rows, stamps_ns[known], poses)


def _need_poses(rows: list[Row], values: Floats) -> None:
    """Rows count by their place, so that none can be left out."""
    row, column = np.nonzero(~np.isfinite(values))
    if len(row):
        found = rows[row[0]].fields[column[0]]
        raise SourceError(
            f"{rows[row[0]].place}: column {column[0] + 1} is {found}; every line must be a pose"
        )


def _need_rotations(rows: list[Row], rotations: Floats) -> None:
    defect = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((defect > 1e-2) | (np.linalg.det(rotations) < 0))
    if len(bad):
        raise SourceError(f"{rows[bad[0]].place}: the 3x3 part is no rotation; check the columns")


def _with_increasing_stamps(rows: list[Row], stamps_ns: Ints, poses: Floats) -> Trajectory:
    """Keep the first pose of each stamp; refuse time that runs backwards."""
    steps = np.diff(stamps_ns)
    backwards = np.flatnonzero(steps < 0)
    if len(backwards):
        row = rows[backwards[0] + 1]
        raise SourceError(
            f"{row.place}: stamp goes back by {-steps[backwards[0]] / _NS_PER_S:.9g} s; "
            "sort the lines by time"
        )
    keep = np.concatenate([[True], steps > 0])
    if not keep.all():
        _log.warning("%s: %d repeated stamps, the first of each kept", rows[0].place, sum(~keep))
    return Trajectory(stamps_ns[keep], poses[keep])
