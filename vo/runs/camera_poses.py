"""Poses of every camera of a rig, at the times of their images, and its calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from vo.base.geometry.transforms import interpolate
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Floats, Ints, Rig
from vo.engine.rig.creation import AnyOdometry
from vo.outputs.results.folder import CAMERA, CAMERAS, write_atomically
from vo.outputs.results.summary import mode_of
from vo.recordings.formats.calibration import ImuCalibration, write_calibration
from vo.recordings.formats.trajectory import pose_fields
from vo.recordings.sources.source import FrameStream, Recording

HEADING = "frame,stamp_ns,camera,tx,ty,tz,qx,qy,qz,qw"

_Stamps = Sequence[tuple[int, ...]] | None


def write_camera_poses(folder: Path, odometry: AnyOdometry, stream: FrameStream) -> None:
    """Write `cameras.csv` for a rig of cameras, and the body where it is known.

    The body is the inertial sensor. Cameras that are corrected are where they were found to be.

    Raises:
        OutputError: the file cannot be written.
    """
    if mode_of(stream.rig) != "rig":
        return
    poses = odometry.corrected(stream.rig).cam0_from_cams
    mounted = {f"cam{number}": pose for number, pose in enumerate(poses)}
    imu = stream.imus[0] if isinstance(stream, Recording) and stream.imus else None
    if imu is not None and imu.cam0_from_imu is not None:
        mounted["body"] = imu.cam0_from_imu
    stamps: _Stamps = getattr(stream, "image_stamps_ns", None)
    lines = camera_pose_lines(odometry.trajectory.path(0), mounted, stamps)
    write_atomically(folder / CAMERAS, "".join(f"{line}\n" for line in (HEADING, *lines)))


def save_calibration(
    folder: Path,
    stream: FrameStream,
    rig: Rig,
    estimated: EstimatedCamera | None,
    file: Path | None,
) -> None:
    """Write a rig to a file if one was asked for, or an estimated camera into the output."""
    if estimated is None and file is None:
        return
    comments = [] if estimated is None else [f"estimated from the images: {estimated.in_words}"]
    sensor = next(iter(stream.imus), None) if isinstance(stream, Recording) else None
    imu = None
    if sensor is not None and sensor.cam0_from_imu is not None:
        imu = ImuCalibration(sensor.cam0_from_imu, sensor.noise, sensor.time_offset_s)
    write_calibration(file or folder / CAMERA, rig, comments, imu)


def camera_pose_lines(
    path: PosedFrames, cam0_from: dict[str, Floats], stamps_ns: _Stamps
) -> Iterator[str]:
    """Rows under `HEADING`, frame by frame.

    `stamps_ns`: times of the images by frame and camera; None with a common trigger.
    """
    times, poses = path.trajectory.stamps_ns, path.trajectory.world_from_cam
    for row, frame in enumerate(path.frame_index.tolist()):
        for number, (name, pose) in enumerate(cam0_from.items()):
            stamp, world_from_cam0 = int(times[row]), poses[row]
            if stamps_ns is not None and number < len(stamps_ns[frame]):
                stamp = stamps_ns[frame][number]
                world_from_cam0 = _at(times, poses, path.segment, row, stamp)
            fields = pose_fields(world_from_cam0 @ pose)
            yield ",".join((str(frame), str(stamp), name, *fields))


def _at(times: Ints, poses: Floats, segment: Ints, row: int, stamp_ns: int) -> Floats:
    """The pose at a time near that of a frame, between it and its neighbour of the same segment."""
    other = row + int(np.sign(stamp_ns - times[row]))
    if other == row or not 0 <= other < len(times) or segment[other] != segment[row]:
        return np.asarray(poses[row])
    ratio = (stamp_ns - int(times[row])) / (int(times[other]) - int(times[row]))
    return interpolate(poses[row], poses[other], min(ratio, 1.0))
