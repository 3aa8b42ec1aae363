"""Rendered recordings of small rigs in a room, without noise, and what runs on them give."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from vo.base.config import load_config
from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse, make_transform, so3_exp
from vo.base.types import Camera, Estimate, Floats, Frame, MountedCamera, Rig, Trajectory
from vo.engine.rig.odometry import RigOdometry
from vo.recordings.formats.calibration import write_calibration

CAMERA = Camera(320, 240, 160.0, 160.0, 159.5, 119.5)  # 90 degrees wide


@dataclass(frozen=True)
class Walk:
    """A recording, and the true path of camera 0."""

    rig: Rig
    frames: list[Frame]
    truth: Trajectory


def at(yaw_deg: float, x: float = 0.0, z: float = 0.0) -> Floats:
    """cam0_from_cam of a camera that is turned to the right."""
    return make_transform(so3_exp(np.array([0.0, np.deg2rad(yaw_deg), 0.0])), np.array([x, 0, z]))


def rig_at(*cam0_from_cams: Floats) -> Rig:
    """Equal cameras at poses (4, 4), the first at the identity."""
    further = tuple(MountedCamera(CAMERA, pose) for pose in cam0_from_cams[2:])
    return Rig(CAMERA, CAMERA, inverse(cam0_from_cams[1]), further=further)


FORWARD_PAIR_AND_SIDES = rig_at(at(0), at(0, 0.2), at(-70, -0.1, -0.15), at(70, 0.3, -0.15))
BACK_TO_BACK = rig_at(at(0), at(180, 0, -0.3))


def render(rig: Rig, folder: Path, settings: Sequence[str]) -> Walk:
    """Render a recipe with a rig."""
    file = folder / "rig.yaml"
    write_calibration(file, rig)
    none = [f"effects.{name}=0" for name in ("blur", "noise", "exposure", "vignetting")]
    plan = make_plan(load_recipe(None, [f"camera={file}", *none, *settings]))
    truth = plan.recording.cam0_truth
    with ThreadPoolExecutor(2) as pool:
        frames = [
            Frame(shot.index, int(truth.stamps_ns[shot.index]), shot.images)
            for shot in render_frames(plan, pool)
        ]
    return Walk(rig, frames, truth)


def track(
    rig: Rig, frames: Iterable[Frame], overrides: Sequence[str] = ()
) -> tuple[list[Estimate], Trajectory]:
    """Run the odometry; the estimates, and the smoothed path."""
    config = load_config(overrides=["threads=1", *overrides])
    with closing(RigOdometry(rig, config)) as odometry:
        estimates = list(odometry.track_all(frames))
        odometry.finish()
        return estimates, odometry.trajectory.trajectory()


def ate(path: Trajectory, truth: Trajectory, *, with_scale: bool = False) -> float:
    """RMSE of the positions after alignment, in metres."""
    return _aligned(path, truth, with_scale)[0]


def scale_of(path: Trajectory, truth: Trajectory) -> float:
    """Length of the true path relative to the estimated one."""
    return _aligned(path, truth, True)[1]


def _aligned(path: Trajectory, truth: Trajectory, with_scale: bool) -> tuple[float, float]:
    rows = np.searchsorted(truth.stamps_ns, path.stamps_ns)
    found = umeyama(path.positions, truth.positions[rows], with_scale=with_scale)
    off = found.transform_points(path.positions) - truth.positions[rows]
    return float(np.sqrt((off**2).sum(axis=1).mean())), found.scale


def edited(frames: Iterable[Frame], edit: Callable[[Frame], Frame]) -> list[Frame]:
    """Frames with something done to each."""
    return [edit(frame) for frame in frames]
