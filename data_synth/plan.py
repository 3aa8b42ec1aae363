"""From a recipe to all that is needed before the first image is rendered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data_synth.cameras import load_rig, with_cameras
from data_synth.motion.body_path import poses_at
from data_synth.motion.imu import measure, with_effects
from data_synth.motion.motions import looking_aside, make_path, mount, moved_aside
from data_synth.motion.spline import PosePath
from data_synth.recipe import Recipe
from data_synth.records import BodyTruth, Imu, MoverTruth, Recording
from data_synth.scene.scene import Scene
from data_synth.scene.world import clearance
from data_synth.sensor.exposure import readout_s
from data_synth.sensor.kidnapping import kidnap, path_seconds
from data_synth.sensor.timing import Timing, make_timing
from data_synth.worlds.registry import make_scene
from data_synth.writers.registry import check
from vo.base.types import Floats, ImuNoise, Rig, Trajectory

FIRST_STAMP_NS = 1_700_000_000_000_000_000

_MIN_CLEARANCE_M = 0.3
_OUT_OF_SIGHT_M = -1e4
_SIDEWAYS = 0.7  # cosine of the angle to the first camera


@dataclass(frozen=True, eq=False)
class Plan:
    """All inputs of the renderer and the writers."""

    recipe: Recipe
    scene: Scene  # the world
    path: PosePath
    timing: Timing
    # (F,) times of the frames on the path; those of `timing`, unless the camera is carried
    # elsewhere
    path_s: Floats
    mover_poses: Floats  # (F, B, 4, 4) world_from_mover by frame
    mover_velocities: Floats  # (F, B, 3) in the world, m/s
    recording: Recording


def make_plan(recipe: Recipe) -> Plan:
    """Build the world, the path through it and the ground truth.

    Raises:
        ConfigError: the recipe is not feasible.
        CalibrationError: the calibration of the camera is invalid.
    """
    rig = load_rig(recipe.camera, scale=recipe.scale, mono=recipe.mono)
    check(recipe, rig)
    rig = _with_readout(rig, readout_s(recipe.effects, recipe.fps))
    scene = make_scene(recipe.world, recipe.seed, recipe.effects.movers, recipe.session)
    path = make_path(
        recipe.motion,
        moved_aside(scene.course, recipe.aside_m),
        lambda points: clearance(scene.world, points),
        seconds=path_seconds(recipe.effects, recipe.seconds),
        speed=recipe.speed,
        seed=recipe.session_seed,
        laps=recipe.laps,
    )
    path = looking_aside(path, recipe.turns, recipe.turn_s)
    body_from_cam0 = mount(recipe.motion, scene.course, level=_looks_around(rig))
    timing = make_timing(
        recipe.effects,
        frames=max(1, round(recipe.seconds * recipe.fps)),
        fps=recipe.fps,
        cameras=len(rig.cameras),
        seed=recipe.session_seed,
        first_stamp_ns=FIRST_STAMP_NS,
    )
    carried = kidnap(
        recipe.effects,
        timing.times_s,
        recipe.seconds,
        lambda times_s: path.world_from_body(times_s)[:, :3, 3],
        recipe.session_seed,
    )
    timing = replace(timing, illumination=np.where(carried.black, 0.0, timing.illumination))
    world_from_cam0 = path.world_from_body(carried.path_s) @ body_from_cam0
    mover_poses, mover_velocities = _movers(scene, timing.times_s, world_from_cam0)
    imu, body = _inertial(recipe, path, timing, carried.path_s)
    recording = Recording(
        name=f"{recipe.world}_{recipe.motion}",
        rig=rig,
        body_from_cam0=body_from_cam0,
        fps=recipe.fps,
        stamps_ns=timing.stamps_ns,
        dropped=timing.dropped,
        cam0_truth=Trajectory(timing.stamps_ns[0], world_from_cam0),
        body_truth=body,
        imu=imu,
        movers=_mover_truths(scene, mover_poses),
        has_depth=recipe.depth or recipe.format == "tum",
    )
    return Plan(
        recipe, scene, path, timing, carried.path_s, mover_poses, mover_velocities, recording
    )


def _with_readout(rig: Rig, seconds: float) -> Rig:
    """The rig with the readout time that is rendered, whatever its calibration file has."""
    return with_cameras(rig, [replace(camera, readout_s=seconds) for camera in rig.cameras])


def _looks_around(rig: Rig) -> bool:
    return bool((rig.cam0_from_cams[:, 2, 2] < _SIDEWAYS).any())


def _movers(scene: Scene, times_s: Floats, world_from_cam0: Floats) -> tuple[Floats, Floats]:
    """Poses (F, B, 4, 4) and velocities (F, B, 3); bodies that would hit the camera are removed."""
    poses = np.tile(np.eye(4), (len(times_s), len(scene.bodies), 1, 1))
    velocities = np.zeros((*poses.shape[:2], 3))
    camera = world_from_cam0[:, :2, 3]
    for i, body in enumerate(scene.bodies):
        poses[:, i], velocities[:, i] = poses_at(body, times_s, scene.course.ground)
        apart = np.linalg.norm(poses[:, i, :2, 3] - camera, axis=1).min()
        if apart < body.radius_m + _MIN_CLEARANCE_M:
            poses[:, i, 2, 3] = _OUT_OF_SIGHT_M
            velocities[:, i] = 0.0
    return poses, velocities


def _mover_truths(scene: Scene, poses: Floats) -> tuple[MoverTruth, ...]:
    return tuple(
        MoverTruth(body.name, poses[:, i])
        for i, body in enumerate(scene.bodies)
        if poses[0, i, 2, 3] != _OUT_OF_SIGHT_M
    )


def _inertial(
    recipe: Recipe, path: PosePath, timing: Timing, path_s: Floats
) -> tuple[Imu | None, BodyTruth]:
    """Inertial measurements and true states; without measurements if the camera is carried."""
    if recipe.effects.kidnap > 0:
        none = np.zeros((len(path_s), 3))
        poses, velocities = path.world_from_body(path_s), path.velocity(path_s)
        return None, BodyTruth(timing.stamps_ns[0], poses, velocities, none, none)
    settings = recipe.imu
    imu, truth = measure(
        path,
        timing.stamps_ns[0],
        FIRST_STAMP_NS,
        rate_hz=settings.rate_hz,
        noise=ImuNoise(
            settings.gyro_noise, settings.gyro_walk, settings.accel_noise, settings.accel_walk
        ),
        seed=recipe.session_seed,
    )
    return with_effects(imu, settings, recipe.session_seed), truth
