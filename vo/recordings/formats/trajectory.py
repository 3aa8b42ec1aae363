"""Trajectories as text, such as TUM, KITTI and EuRoC, with stamps exact to the nanosecond."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from vo.base.errors import OutputError, SourceError
from vo.base.geometry.transforms import quat_xyzw_of_rows, rotation_from_quat_xyzw
from vo.base.printable import counted
from vo.base.types import Floats, Ints, Trajectory
from vo.recordings.formats.stamp_units import POSES, StampUnit, parse_stamps
from vo.recordings.formats.table import (
    Line,
    check_columns,
    parse_columns,
    read_poses_table,
    read_table,
)

TrajectoryFormat = Literal["tum", "kitti", "euroc", "tartanair", "nerf"]

_log = logging.getLogger(__name__)
_NS_PER_S = 1_000_000_000
_TUM_COLUMNS = 8
_KITTI_COLUMNS = 12
_EUROC_COLUMNS = 8
_TARTANAIR_COLUMNS = 7
_NED_FROM_CAM = np.array(
    [[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From a camera's axes (x right, y down, z forward) to TartanAir's (x forward, y right, z down)."""


def read_trajectory(path: Path | str) -> Trajectory:
    """Read a trajectory in one of the formats, detected from the content.

    Stamps of KITTI, TartanAir and NeRF files come from a `times.txt` of the same length beside it;
    without one, pose i gets the stamp of i seconds.

    Raises:
        SourceError: the file is missing, empty, damaged or of none of the formats.
    """
    path = Path(path)
    kind = detect_format(path)
    _log.info("%s: trajectory of format %s", path, kind)
    if kind == "tum":
        return read_tum(path)
    if kind == "euroc":
        return read_euroc(path)
    stamps_ns = stamps_beside(path)
    if kind == "tartanair":
        return read_tartanair(path, stamps_ns)
    return read_kitti(path, stamps_ns) if kind == "kitti" else read_nerf(path, stamps_ns)


def has_stamps(path: Path | str) -> bool:
    """Whether the poses of a file have stamps, in the file or in a `times.txt` beside it."""
    return detect_format(path) in ("tum", "euroc") or stamps_beside(path) is not None


def detect_format(path: Path | str) -> TrajectoryFormat:
    """Detect the format from the first line of data."""
    if Path(path).suffix.lower() == ".json":
        return "nerf"
    first = read_poses_table(Path(path))[0]
    columns = len(first.fields)
    if first.has_commas and columns >= _EUROC_COLUMNS:
        return "euroc"
    if columns == _TUM_COLUMNS:
        return "tum"
    if columns == _KITTI_COLUMNS or (columns == 16 and _is_last_row(first.fields[12:])):
        return "kitti"
    if columns == _TARTANAIR_COLUMNS and not first.has_commas:
        return "tartanair"
    raise SourceError(
        f"{first.location}: {columns} columns are not a trajectory; TUM has 8 (stamp tx ty tz qx "
        "qy qz qw), KITTI 12 (a 3x4 matrix), TartanAir 7 (tx ty tz qx qy qz qw), EuRoC 8 or more "
        "with commas and stamps in nanoseconds"
    )


def _is_last_row(fields: Sequence[str]) -> bool:
    """Whether numbers are the last row of a 4x4 matrix."""
    try:
        return [float(field) for field in fields] == [0.0, 0.0, 0.0, 1.0]
    except ValueError:
        return False


def read_tum(path: Path | str) -> Trajectory:
    """Read `stamp tx ty tz qx qy qz qw` lines, stamps in decimal seconds."""
    lines = read_poses_table(Path(path))
    check_columns(lines, _TUM_COLUMNS, exactly=True)
    stamps = _stamps(lines, "s")
    values = parse_columns(lines, 1, _TUM_COLUMNS)
    return _trajectory(lines, stamps, values[:, :3], values[:, 3:7])


def read_euroc(path: Path | str) -> Trajectory:
    """Read a EuRoC ground truth CSV: `stamp_ns, x, y, z, qw, qx, qy, qz, …`.

    The poses are those of the body, world_from_body; the body is the IMU.
    """
    lines = read_poses_table(Path(path))
    check_columns(lines, _EUROC_COLUMNS, exactly=False)
    stamps = _stamps(lines, "ns")
    values = parse_columns(lines, 1, _EUROC_COLUMNS)
    quat_xyzw = values[:, [4, 5, 6, 3]]
    return _trajectory(lines, stamps, values[:, :3], quat_xyzw)


def read_four_seasons(path: Path | str) -> Trajectory:
    """Read GNSSPoses.txt of 4Seasons: `stamp_ns, tx, ty, tz, qx, qy, qz, qw, scale, quality, …`.

    The poses are those of the left camera at keyframes, in metres. The scale is that of the visual
    path in the data set and is not used.
    """
    lines = read_table(Path(path))
    check_columns(lines, _EUROC_COLUMNS, exactly=False)
    stamps = _stamps(lines, "ns")
    values = parse_columns(lines, 1, _EUROC_COLUMNS)
    return _trajectory(lines, stamps, values[:, :3], values[:, 3:7])


def read_kitti(path: Path | str, stamps_ns: Ints | None = None) -> Trajectory:
    """Read lines of twelve numbers, each a 3x4 world_from_cam0 in row-major order; or of sixteen.

    Rotations are not re-orthonormalised; KITTI gives seven digits.

    `stamps_ns`: (N,) stamps of the poses; by default pose i gets i seconds.
    """
    lines, values = _read_numbers(path, _KITTI_COLUMNS, or_more=True)
    values = values[:, :_KITTI_COLUMNS]
    stamps_ns = _or_whole_seconds(path, stamps_ns, len(lines))
    poses = np.tile(np.eye(4), (len(lines), 1, 1))
    poses[:, :3, :] = values.reshape(-1, 3, 4)
    _check_rotations(lines, poses[:, :3, :3])
    return _with_increasing_stamps(lines, stamps_ns, poses)


def read_tartanair(path: Path | str, stamps_ns: Ints | None = None) -> Trajectory:
    """Read TartanAir's lines `tx ty tz qx qy qz qw`: poses in a world with x north and z down.

    The camera's axes in the file are x forward, y right, z down; the result has those of an image.

    `stamps_ns`: (N,) stamps of the poses; by default pose i gets i seconds.
    """
    lines, values = _read_numbers(path, _TARTANAIR_COLUMNS)
    stamps_ns = _or_whole_seconds(path, stamps_ns, len(lines))
    found = _trajectory(lines, stamps_ns, values[:, :3], values[:, 3:7])
    return Trajectory(found.stamps_ns, found.world_from_cam @ _NED_FROM_CAM)


def read_nerf(path: Path | str, stamps_ns: Ints | None = None) -> Trajectory:
    """Read the poses of NeRF's `transforms.json`, in natural order of the names of the images.

    `stamps_ns`: (N,) stamps of the poses; by default pose i gets i seconds.
    """
    from vo.recordings.formats.calibration.nerf import read_nerf_poses

    poses = [image.world_from_cam for image in read_nerf_poses(path)]
    return Trajectory(_or_whole_seconds(path, stamps_ns, len(poses)), np.stack(poses))


def _or_whole_seconds(path: Path | str, stamps_ns: Ints | None, count: int) -> Ints:
    """The stamps, or 0 s, 1 s and so on without any."""
    if stamps_ns is None:
        return np.arange(count, dtype=np.int64) * _NS_PER_S
    if len(stamps_ns) != count:
        raise SourceError(
            f"{path}: {counted(count, 'pose')} but {counted(len(stamps_ns), 'stamp')}; give as many"
        )
    return stamps_ns


def read_kitti_times(path: Path | str) -> Ints:
    """Read a KITTI `times.txt`, one stamp per line, as (N,) nanoseconds.

    Stamps are seconds, unless images would then be implausibly far apart, as with milliseconds.
    """
    lines = read_table(Path(path))
    check_columns(lines, 1, exactly=True)
    return np.array(parse_stamps(lines, "s"), dtype=np.int64)


def stamps_beside(path: Path | str) -> Ints | None:
    """The stamps in `times.txt` beside a file of poses, or None if missing or not as many."""
    times = Path(path).with_name("times.txt")
    if not times.is_file():
        return None
    stamps_ns = read_kitti_times(times)
    is_nerf = detect_format(path) == "nerf"
    count = len(read_nerf(path).stamps_ns) if is_nerf else len(read_table(Path(path)))
    if len(stamps_ns) != count:
        _log.warning("%s has %d stamps for %d poses: not used", times, len(stamps_ns), count)
        return None
    return stamps_ns


def tum_line(stamp_ns: int, world_from_cam: Floats) -> str:
    """One line `stamp tx ty tz qx qy qz qw`, without line end, the stamp to the nanosecond."""
    return tum_line_of_fields(stamp_ns, pose_fields(world_from_cam))


def tum_line_of_fields(stamp_ns: int, fields: Sequence[str]) -> str:
    """As `tum_line`, given the result of `pose_fields`."""
    seconds, nanoseconds = divmod(abs(int(stamp_ns)), _NS_PER_S)
    sign = "-" if stamp_ns < 0 else ""
    return f"{sign}{seconds}.{nanoseconds:09d} {' '.join(fields)}"


def pose_fields(world_from_cam: Floats) -> list[str]:
    """Format `tx ty tz qx qy qz qw` with nine decimals each; qw is not negative."""
    (fields,) = fields_of_poses(world_from_cam[None])
    return fields


def fields_of_poses(world_from_cam: Floats) -> list[list[str]]:
    """The same of many poses (N, 4, 4)."""
    result = []
    for rows in world_from_cam[:, :3].tolist():
        quat_xyzw = quat_xyzw_of_rows(rows)
        if quat_xyzw[3] < 0:
            quat_xyzw = [-q for q in quat_xyzw]
        numbers = (rows[0][3], rows[1][3], rows[2][3], *quat_xyzw)
        result.append([f"{value:z.9f}" for value in numbers])
    return result


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


def _stamps(lines: list[Line], unit: StampUnit) -> Ints:
    return np.array(parse_stamps(lines, unit, spacing=POSES), dtype=np.int64)


def _trajectory(lines: list[Line], stamps_ns: Ints, xyz: Floats, quat_xyzw: Floats) -> Trajectory:
    """A trajectory from positions (N, 3) and quaternions (N, 4), not normalised.

    NaN and zero quaternions, which motion capture writes for unobserved poses, are left out.
    """
    finite = np.isfinite(xyz).all(axis=1) & np.isfinite(quat_xyzw).all(axis=1)
    known = finite & (np.linalg.norm(quat_xyzw, axis=1) >= 1e-6)
    unknown = np.flatnonzero(~known)
    if len(unknown):
        problem = f"{len(unknown)} of {len(lines)} lines are not poses (NaN, or a zero quaternion)"
        first = lines[unknown[0]].location
        if len(unknown) == len(lines):
            raise SourceError(f"{first}: {problem}; give a trajectory with at least one pose")
        _log.warning("%s: %s and are left out; this is the first", first, problem)
    lines = [lines[i] for i in np.flatnonzero(known)]
    poses = np.tile(np.eye(4), (len(lines), 1, 1))
    poses[:, :3, :3] = rotation_from_quat_xyzw(quat_xyzw[known])
    poses[:, :3, 3] = xyz[known]
    return _with_increasing_stamps(lines, stamps_ns[known], poses)


def _read_numbers(
    path: Path | str, columns: int, *, or_more: bool = False
) -> tuple[list[Line], Floats]:
    """The lines of a table of finite numbers alone, and the numbers (N, columns).

    `or_more`: as many columns as the first line has, if these are more.
    """
    lines = read_table(Path(path))
    columns = max(columns, len(lines[0].fields)) if or_more else columns
    check_columns(lines, columns, exactly=True)
    values = parse_columns(lines, 0, columns)
    _check_finite(lines, values)
    return lines, values


def _check_finite(lines: list[Line], values: Floats) -> None:
    """Refuse NaN and infinity: stamps are assigned by line number, so no line can be left out."""
    index, column = np.nonzero(~np.isfinite(values))
    if len(index):
        line = lines[index[0]]
        found = line.fields[column[0]]
        raise SourceError(
            f"{line.location}: column {column[0] + 1} is {found}; every line must be a pose"
        )


def _check_rotations(lines: list[Line], rotations: Floats) -> None:
    defect = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((defect > 1e-2) | (np.linalg.det(rotations) < 0))
    if len(bad):
        raise SourceError(
            f"{lines[bad[0]].location}: the 3x3 part is not a rotation; check the columns"
        )


def _with_increasing_stamps(lines: list[Line], stamps_ns: Ints, poses: Floats) -> Trajectory:
    """Keep the first pose of each stamp; refuse stamps that decrease."""
    steps = np.diff(stamps_ns)
    backwards = np.flatnonzero(steps < 0)
    if len(backwards):
        line = lines[backwards[0] + 1]
        raise SourceError(
            f"{line.location}: stamp goes back by {-steps[backwards[0]] / _NS_PER_S:.9g} s; "
            "sort the lines by time"
        )
    keep = np.concatenate([[True], steps > 0])
    if not keep.all():
        _log.warning(
            "%s: %s with a repeated stamp left out",
            lines[0].location,
            counted(int(np.sum(~keep)), "pose"),
        )
    return Trajectory(stamps_ns[keep], poses[keep])
