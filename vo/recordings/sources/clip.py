"""Videos of phones and action cameras: what is recorded with them, in the file or beside it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.base.types import Floats, Mode, Trajectory
from vo.recordings.formats.calibration import Calibration
from vo.recordings.formats.headings import split_fields
from vo.recordings.formats.stamp_units import STATED, StampText, parse_stamps
from vo.recordings.sources.assembly import RecordingContents, first_existing
from vo.recordings.sources.gopro import open_gopro
from vo.recordings.sources.imu import FileImu, Imu, ImuSamples, imu_of
from vo.recordings.sources.imu_table import read_imu_table
from vo.recordings.sources.listing import Shot, read_lines, shots_from_times
from vo.recordings.sources.motion_tracks import STANDARD_GRAVITY, read_motion_track
from vo.recordings.sources.video_file import gather_video

_log = logging.getLogger(__name__)
_IN_G = (0.5, 1.5)
# Of an iPhone: x right, y up, z to the user in portrait; its camera as held in landscape.
_CAM0_FROM_IPHONE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def gather_clip(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List the frames of a video, with the sensor in it or in a table beside it.

    The table is `CLIP_imu.csv`, `CLIP.imu.csv`, `imu.csv` or `gyro_accel.csv`, and the stamps of
    the frames on its clock are in `CLIP_timestamps.txt` or `frame_timestamps.txt`.
    """
    contents = gather_video(path, calibration, mode)
    track = read_motion_track(path)
    if track is not None:
        if track.stabilisation:
            _log.warning(
                "%s was stabilised in the camera (%s): each image is turned and cut in another "
                "way, so that no lens fits and the sensor does not; record without it",
                path,
                track.stabilisation,
            )
        if track.imu is not None:
            find = _finder(f"{path} ({track.name})", track.imu, track.cam0_from_imu)
            return replace(contents, find_imus=find)
    stem = path.with_suffix("")
    table = first_existing(
        [Path(f"{stem}_imu.csv"), Path(f"{stem}.imu.csv")]
        + [path.with_name(name) for name in ("imu.csv", "gyro_accel.csv")]
    )
    if table is None:
        return contents
    times = first_existing([Path(f"{stem}_timestamps.txt"), path.with_name("frame_timestamps.txt")])
    shots = contents.left if times is None else _with_times(contents.left, times)
    first_ns, last_ns = shots[0].stamp_ns, shots[-1].stamp_ns

    def load() -> ImuSamples:
        found = read_imu_table(table)
        if found.stamps_ns[0] < last_ns and first_ns < found.stamps_ns[-1]:
            return found
        _log.warning(
            "%s and %s are of different clocks: both are taken to begin at the same time; put the "
            "stamps of the frames on the clock of the sensor, one a line, into %s_timestamps.txt",
            path,
            table.name,
            stem.name,
        )
        return replace(found, stamps_ns=found.stamps_ns + (first_ns - found.stamps_ns[0]))

    return replace(contents, left=shots, find_imus=_finder(str(table), load))


def gopro_imu(path: Path) -> Imu:
    """The sensor of a raw stream of GoPro's telemetry, which has no images."""
    gopro = open_gopro(path)
    if gopro is None or not gopro.has_imu:
        raise SourceError(f"{path} has no inertial samples (GYRO and ACCL of GPMF)")
    return _finder(f"{path} (GPMF)", gopro.imu, gopro.cam0_from_imu)(None)[0]


def gather_stray(folder: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a recording of Stray Scanner: video, camera, sensor, and poses of ARKit as truth.

    Depth images, which are smaller than the video, are left out.

    Source: Stray Scanner, "Data Specification" (docs/format.md of strayrobots/scanner); axes of
        CoreMotion and ARKit.
    """
    contents = gather_video(folder / "rgb.mp4", calibration or folder / "camera_matrix.csv", mode)
    left = list(contents.left)
    truth = None
    if (folder / "odometry.csv").is_file():
        truth = _arkit_poses(folder / "odometry.csv")
        stamps = truth.stamps_ns.tolist()
        if abs(len(stamps) - len(left)) > 1:
            raise SourceError(
                f"{folder} has {len(left)} images but {len(stamps)} poses in odometry.csv; give "
                f"`{folder / 'rgb.mp4'}` to leave them out"
            )
        left = [s._replace(stamp_ns=ns) for s, ns in zip(left, stamps, strict=False)]
    imu, pose = folder / "imu.csv", make_transform(_CAM0_FROM_IPHONE, np.zeros(3))
    found = _finder(str(imu), lambda: _specific_force(read_imu_table(imu)), pose)
    return replace(
        contents,
        name=folder.resolve().name,
        format="stray",
        left=left,
        read_truth=lambda _: truth,
        find_imus=found if imu.is_file() else contents.find_imus,
    )


def _finder(
    name: str, load: Callable[[], ImuSamples], cam0_from_imu: Floats | None = None
) -> Callable[[Calibration | None], Sequence[Imu]]:
    """Lists one sensor, whose pose the calibration may know."""

    def find(calibration: Calibration | None) -> Sequence[Imu]:
        given = imu_of(calibration)
        pose = cam0_from_imu if given.cam0_from_imu is None else given.cam0_from_imu
        return [FileImu(name, load, lambda: pose, lambda: given.noise, given.time_offset_s)]

    return find


def _arkit_poses(table: Path) -> Trajectory:
    """Poses of the camera, one for each image."""
    lines = read_lines(table)
    rows = [split_fields(line.text) for line in lines]
    try:
        values = np.array([[float(each) for each in row[:9]] for row in rows])[:, 2:]
        rotations = rotation_from_quat_xyzw(values[:, 3:])
    except (ValueError, IndexError) as error:
        raise SourceError(
            f"{table} has other columns than timestamp, frame, x, y, z, qx, qy, qz, qw ({error})"
        ) from error
    texts = [StampText(line.location, row[0]) for line, row in zip(lines, rows, strict=True)]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, values[:, :3]
    return Trajectory(np.array(parse_stamps(texts, "s", spacing=STATED), np.int64), poses)


def _specific_force(samples: ImuSamples) -> ImuSamples:
    """Accelerations of CoreMotion, in g and downwards at rest, as m/s² and upwards."""
    mean = float(np.linalg.norm(samples.accel, axis=1).mean())
    if not _IN_G[0] < mean < _IN_G[1]:
        return samples
    return replace(samples, accel=-STANDARD_GRAVITY * samples.accel)


def _with_times(shots: Sequence[Shot], times: Path) -> list[Shot]:
    """The same images with the stamps in a table that has one for each."""
    names = [Path(f"{number}") for number in range(len(shots))]
    stamped = shots_from_times(times, names)
    return [s._replace(stamp_ns=each.stamp_ns) for s, each in zip(shots, stamped, strict=True)]
