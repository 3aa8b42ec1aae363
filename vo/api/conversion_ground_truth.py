"""Conversion of ground truth."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from data_synth.records import BodyTruth, Recording
from data_synth.writers.tables import seconds_text, write_lines
from vo.base.geometry.transforms import interpolate, inverse
from vo.base.types import Bools, Floats, Ints, Trajectory
from vo.recordings.formats.trajectory import write_tum


def poses_around(stamps_ns: Ints, truth: Trajectory | None) -> Trajectory | None:
    """Poses during the frames, with one more at either end; None without any."""
    if truth is None:
        return None
    first = max(0, int(np.searchsorted(truth.stamps_ns, stamps_ns[0], side="right")) - 1)
    last = int(np.searchsorted(truth.stamps_ns, stamps_ns[-1])) + 1
    kept = slice(first, last)
    part = Trajectory(truth.stamps_ns[kept], truth.world_from_cam[kept])
    return part if _covered(stamps_ns, part).any() else None


def no_poses() -> Trajectory:
    """An empty trajectory."""
    return Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))


def poses_at(stamps_ns: Ints, truth: Trajectory | None) -> Trajectory:
    """Poses at the frames: interpolated within the ground truth, else the identity."""
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    if truth is not None:
        for row in np.flatnonzero(_covered(stamps_ns, truth)):
            poses[row] = _pose_at(truth, int(stamps_ns[row]))
    return Trajectory(stamps_ns, poses)


def _covered(stamps_ns: Ints, truth: Trajectory) -> Bools:
    inside = (stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])
    return np.asarray(inside, dtype=np.bool_)


def _pose_at(truth: Trajectory, stamp_ns: int) -> Floats:
    after = int(np.searchsorted(truth.stamps_ns, stamp_ns))
    if truth.stamps_ns[after] == stamp_ns:
        return np.asarray(truth.world_from_cam[after])
    before_ns, after_ns = truth.stamps_ns[after - 1], truth.stamps_ns[after]
    fraction = float(stamp_ns - before_ns) / float(after_ns - before_ns)
    return interpolate(truth.world_from_cam[after - 1], truth.world_from_cam[after], fraction)


def body_truth(truth: Trajectory | None, cam0_from_body: Floats) -> BodyTruth:
    """Poses of the body from those of cam0, with velocities by finite differences."""
    truth = truth or no_poses()
    count = len(truth)
    world_from_body = truth.world_from_cam @ cam0_from_body
    velocity: Floats = np.zeros((count, 3))
    if count > 1:
        seconds = 1e-9 * (truth.stamps_ns - truth.stamps_ns[0]).astype(np.float64)
        velocity = np.asarray(np.gradient(world_from_body[:, :3, 3], seconds, axis=0))
    zero_bias = np.zeros((count, 3))
    return BodyTruth(truth.stamps_ns, world_from_body, velocity, zero_bias, zero_bias)


def write_original_truth(
    path: Path, format: str, recording: Recording, truth: Trajectory | None
) -> None:
    """Replace the ground truth at the frames by that at its own stamps; remove it if unknown."""
    if format.startswith("mcap"):
        return
    if truth is None:
        for name in ("groundtruth.tum", "groundtruth.txt", "poses.txt"):
            (path / name).unlink(missing_ok=True)
        shutil.rmtree(path / "mav0" / "state_groundtruth_estimate0", ignore_errors=True)
    elif format != "kitti":
        write_tum(path / "groundtruth.tum", truth)
    if format == "kitti":
        stamps_ns = recording.stamps_ns[0]
        # KITTI times start at the first frame; here the original stamps are kept.
        write_lines(path / "times.txt", map(seconds_text, stamps_ns.tolist()))
        if truth is not None and not _covered(stamps_ns, truth).all():
            (path / "poses.txt").unlink()
            first_from_world = inverse(truth.world_from_cam[0])
            moved = Trajectory(truth.stamps_ns, first_from_world @ truth.world_from_cam)
            write_tum(path / "groundtruth.tum", moved)
