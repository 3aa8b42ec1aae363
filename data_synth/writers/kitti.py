"""Writer of the KITTI odometry layout: a rectified pair, or one camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_synth.records import MoverTruth, Recording, Shot
from data_synth.writers.encoding import SUFFIXES, write_images
from data_synth.writers.limits import check_kitti
from data_synth.writers.tables import seconds_text, write_lines, write_movers
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Rig, Trajectory


def write(path: Path, recording: Recording, shots: Iterator[Shot], codec: str) -> None:
    """Write `image_0`, `image_1`, `calib.txt`, `times.txt` and `poses.txt`.

    Colour images go to `image_2` and `image_3`. As in KITTI, time starts at the first frame and the
    world frame is cam0 at that time; both images of a pair have the time of cam0. Also, if present,
    `depth/` (float32 TIFF) and `movers.csv`. Inertial data are not written.

    Raises:
        ConfigError: the layout cannot represent the recording.
        OSError: a file cannot be written.
    """
    check_kitti(recording.rig, any(dropped.any() for dropped in recording.dropped))
    recording = _from_first_frame(recording)
    first = 2 if recording.has_colour else 0
    folders = [path / f"image_{first + camera}" for camera in range(len(recording.stamps_ns))]
    for folder in folders:
        folder.mkdir(parents=True)
    write_lines(path / "calib.txt", _calibration(recording.rig))
    write_lines(path / "times.txt", map(seconds_text, recording.stamps_ns[0].tolist()))
    poses = recording.cam0_truth.world_from_cam
    write_lines(path / "poses.txt", (_row(pose[:3]) for pose in poses))
    write_movers(path / "movers.csv", recording)
    if recording.has_depth:
        (path / "depth").mkdir()
    suffix = SUFFIXES[codec]
    write_images(
        shots,
        codec,
        lambda camera, index: folders[camera] / f"{index:06d}{suffix}",
        lambda index: path / "depth" / f"{index:06d}.tiff",
    )


def _from_first_frame(recording: Recording) -> Recording:
    """The recording relative to the pose and time of the first frame."""
    truth = recording.cam0_truth
    start_ns = truth.stamps_ns[0]
    first_from_world = inverse(truth.world_from_cam[0])
    movers = tuple(
        MoverTruth(mover.name, first_from_world @ mover.world_from_mover)
        for mover in recording.movers
    )
    return replace(
        recording,
        stamps_ns=tuple(stamps - start_ns for stamps in recording.stamps_ns),
        cam0_truth=Trajectory(truth.stamps_ns - start_ns, first_from_world @ truth.world_from_cam),
        movers=movers,
    )


def _calibration(rig: Rig) -> Iterator[str]:
    """P0…P3; the grey and the colour pair are equal, and only one of them has images."""
    left = np.hstack([rig.cam0.matrix, np.zeros((3, 1))])
    if rig.cam1_from_cam0 is None:
        yield from (f"P{camera}: {_row(left)}" for camera in (0, 2))
        return
    right = rig.cam0.matrix @ rig.cam1_from_cam0[:3]
    right[:, :3] = rig.cam0.matrix
    for camera, matrix in enumerate((left, right, left, right)):
        yield f"P{camera}: {_row(matrix)}"


def _row(matrix: Floats) -> str:
    # Rounded, so that the first pose is written as the exact identity and zeros have no sign.
    return " ".join(f"{value:.12e}" for value in np.round(matrix, 12).ravel() + 0.0)
