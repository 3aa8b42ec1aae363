"""Wheels of a vehicle with a camera (z ahead, y down), simulated from the camera's path."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Floats, Trajectory

BASE_IN_CAM = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Columns: ahead, left and up in the frame of the camera."""


class Wheels(NamedTuple):
    """Errors of wheels; `arm_m`: of the camera, ahead and to the left."""

    noise: float = 0.01
    radius: float = 1.0
    late_s: float = 0.0
    arm_m: tuple[float, float] = (0.0, 0.0)
    slip_s: tuple[float, float] = (0.0, 0.0)


def arc_path(
    seconds: float,
    *,
    turning: float = 0.4,
    changing: float = 0.4,
    arm_m: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """A camera at 20 frames/s on a base that rolls at about 2 m/s."""
    fine = np.arange(0.0, seconds, 0.005)
    speed = 2.0 * (1.0 + changing * np.sin(0.9 * fine))
    heading = np.cumsum(turning * np.sin(0.35 * fine)) * 0.005
    xyz = np.cumsum(
        0.005 * speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading), 0.0 * heading]),
        axis=0,
    )
    rows = slice(None, None, 10)
    across = np.column_stack([-np.sin(heading), np.cos(heading), 0.0 * heading])
    ahead = np.column_stack([np.cos(heading), np.sin(heading), 0.0 * heading])
    xyz += arm_m[0] * ahead + arm_m[1] * across
    return Trajectory(
        1_700_000_000_000_000_000 + np.round(1e9 * fine[rows]).astype(np.int64),
        camera_poses(xyz[rows], heading[rows]),
    )


def camera_poses(xyz: Floats, heading: Floats) -> Floats:
    """(N, 4, 4) of cameras that look ahead."""
    poses = np.tile(np.eye(4), (len(xyz), 1, 1))
    c, s, zero = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    base = np.stack(
        [
            np.stack([c, -s, zero], axis=1),
            np.stack([s, c, zero], axis=1),
            np.stack([zero, zero, zero + 1.0], axis=1),
        ],
        axis=1,
    )
    poses[:, :3, :3] = base @ BASE_IN_CAM.T
    poses[:, :3, 3] = xyz
    return poses


def write_csv(path: Path, truth: Trajectory, wheels: Wheels, seed: int = 0) -> Path:
    """Speeds and yaw rates at 50 Hz."""
    rng = np.random.default_rng(seed)
    known = 1e-9 * (truth.stamps_ns - truth.stamps_ns[0])
    times = np.arange(0.0, known[-1], 0.02)
    base = truth.world_from_cam[:, :3, :3] @ BASE_IN_CAM
    heading = np.unwrap(np.arctan2(base[:, 1, 0], base[:, 0, 0]))
    yaw_rate = np.interp(times, 0.5 * (known[1:] + known[:-1]), np.diff(heading) / np.diff(known))
    arm = base @ np.array([*wheels.arm_m, 0.0])
    way = np.diff(truth.positions - arm, axis=0)
    ahead = base[:-1, :, 0] + base[1:, :, 0]
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    speed = np.interp(
        times, 0.5 * (known[1:] + known[:-1]), (way * ahead).sum(axis=1) / np.diff(known)
    )
    speed *= wheels.radius * (1.0 + rng.normal(0.0, max(wheels.noise, 1e-300), len(times)))
    slips = (times >= wheels.slip_s[0]) & (times < wheels.slip_s[1])
    speed[slips] *= 1.6
    stamps_ns = truth.stamps_ns[0] + np.round(1e9 * (times + wheels.late_s)).astype(np.int64)
    rows = zip(stamps_ns.tolist(), speed.tolist(), yaw_rate.tolist(), strict=True)
    lines = [f"{stamp},{v:.7f},{w:.7f}" for stamp, v, w in rows]
    path.write_text("\n".join(["stamp_ns,speed,yaw_rate", *lines]) + "\n")
    return path


def posed(path: Trajectory, scale: float = 1.0) -> PosedFrames:
    """A path of one segment, in units of `scale` metres."""
    poses = path.world_from_cam.copy()
    poses[:, :3, 3] /= scale
    zeros = np.zeros(len(poses), np.int64)
    is_none = zeros > 0
    moved = Trajectory(path.stamps_ns, poses)
    return PosedFrames(np.arange(len(poses)), zeros, zeros, is_none, is_none, moved)
