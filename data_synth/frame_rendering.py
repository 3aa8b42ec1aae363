"""Rendering of the frames of a plan, with the effects of the sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from data_synth.plan import Plan
from data_synth.records import Shot
from data_synth.scene.builder import with_bodies
from data_synth.scene.render import Rendered, camera_rays, render
from data_synth.scene.shutter import Shutter, moving_shutter, static_shutter
from data_synth.scene.wide_render import Face, faces_of, render_faces, sees_behind
from data_synth.scene.world import World
from data_synth.sensor.exposure import AutoExposure, Settings, readout_s
from data_synth.sensor.photometrics import develop, vignetting
from vo.base.types import Bytes, Camera, Floats, Floats32

_PREVIEW_STEP = 8
_SEED_NOISE = 2
_FRAMES_AT_ONCE = 2


@dataclass(frozen=True, eq=False)
class _CameraSetup:
    """A camera with its rays, or with the faces of a wide lens, prepared for rendering."""

    camera: Camera
    rays: Floats
    faces: tuple[Face, ...]
    vignette: Floats32
    body_from_cam: Floats

    def render(
        self, world: World, shutter_at: Callable[[Floats], Shutter], pool: ThreadPoolExecutor
    ) -> Rendered:
        """One image; `shutter_at` gives the shutter of a camera from its pose on the body."""
        if not self.faces:
            return render(world, self.rays, shutter_at(self.body_from_cam), pool)
        return render_faces(
            world, self.faces, lambda pose: shutter_at(self.body_from_cam @ pose), pool
        )


_ImageAndDepth = tuple[Bytes, Floats32 | None]


@dataclass(frozen=True, eq=False)
class _PendingFrame:
    """A frame whose images are being rendered."""

    index: int
    images: tuple[Future[_ImageAndDepth] | None, ...]

    def mean(self) -> float | None:
        """Mean of cam0's image, 0…1."""
        return None if self.images[0] is None else float(self.images[0].result()[0].mean()) / 255.0

    def shot(self) -> Shot:
        """The images, once they are done."""
        done = tuple(None if image is None else image.result()[0] for image in self.images)
        depth = None if self.images[0] is None else self.images[0].result()[1]
        return Shot(self.index, done, depth)


def render_frames(
    plan: Plan, pool: ThreadPoolExecutor, frames: range | None = None
) -> Iterator[Shot]:
    """Render frames in order.

    Both images of a frame and those of the next are rendered at the same time, which keeps all
    cores busy while the last rows of an image are rendered. Therefore the exposure of a frame
    depends on the image two frames before.

    `pool`: threads that share the rows of an image; their number does not change the result.
    `frames`: which frames, by default all; the first one has a settled exposure.
    """
    frames = range(len(plan.recording)) if frames is None else frames
    if len(frames) == 0:
        return
    setups = _camera_setups(plan)
    effects, fps = plan.recipe.effects, plan.recipe.fps
    auto = AutoExposure(effects, fps, _preview_mean(plan, setups[0], frames[0], pool))
    previous: _PendingFrame | None = None
    # Threads of `images` wait for threads of `pool`, which wait for none: no deadlock.
    with ThreadPoolExecutor(_FRAMES_AT_ONCE * len(setups), thread_name_prefix="render") as images:
        for index in frames:
            pending = _start_frame(plan, setups, index, auto.next(), images, pool)
            if previous is not None:
                auto.observe(previous.mean())
                yield previous.shot()
            previous = pending
        if previous is not None:
            yield previous.shot()


def _camera_setups(plan: Plan) -> tuple[_CameraSetup, ...]:
    rig, strength = plan.recording.rig, plan.recipe.effects.vignetting
    setups = []
    for camera, body_from_cam in zip(rig.cameras, plan.recording.body_from_cams, strict=True):
        faces = faces_of(camera) if sees_behind(camera) else ()
        rays = np.empty((0, 0, 3)) if faces else camera_rays(camera)
        shade = vignetting(camera, strength)
        setups.append(_CameraSetup(camera, rays, faces, shade, body_from_cam))
    return tuple(setups)


def _preview_mean(plan: Plan, setup: _CameraSetup, index: int, pool: ThreadPoolExecutor) -> float:
    """Mean radiance of a view in the light of the start, from a fraction of its pixels."""
    step = _PREVIEW_STEP
    world_from_body = plan.path.world_from_body(plan.path_s[index : index + 1])[0]
    if setup.faces:
        step, world = 1, _world(plan, index)
        view = setup.render(world, lambda pose: static_shutter(world_from_body @ pose), pool)
    else:
        rays = np.ascontiguousarray(setup.rays[::step, ::step])
        view = render(
            _world(plan, index), rays, static_shutter(world_from_body @ setup.body_from_cam), pool
        )
    light = plan.recipe.effects.light
    return light * float((view.image * setup.vignette[::step, ::step]).mean())


def _start_frame(
    plan: Plan,
    setups: tuple[_CameraSetup, ...],
    index: int,
    settings: Settings,
    images: ThreadPoolExecutor,
    pool: ThreadPoolExecutor,
) -> _PendingFrame:
    """Start to render the images of a frame, each in a thread of `images`."""
    dropped = plan.timing.dropped

    def render_camera(number: int) -> _ImageAndDepth:
        late_s = plan.timing.late_s[number]

        def shutter_at(body_from_cam: Floats) -> Shutter:
            rows = setups[number].camera.height
            return _shutter(plan, body_from_cam, rows, index, settings, late_s)

        view = setups[number].render(_world(plan, index, late_s), shutter_at, pool)
        image = develop(
            view.image,
            settings,
            plan.recipe.effects,
            float(plan.timing.illumination[index]),
            setups[number].vignette,
            np.random.default_rng([plan.recipe.session_seed, _SEED_NOISE, index, number]),
        )
        return image, view.depth if number == 0 and plan.recording.has_depth else None

    return _PendingFrame(
        index,
        tuple(
            None if dropped[number][index] else images.submit(render_camera, number)
            for number in range(len(setups))
        ),
    )


def _world(plan: Plan, index: int, late_s: float = 0.0) -> World:
    """The world with all moving bodies where they are in the middle of a camera's exposure."""
    if plan.mover_poses.shape[1] == 0:
        return plan.scene.world
    poses, velocities = plan.mover_poses[index], plan.mover_velocities[index]
    if late_s:
        poses = poses.copy()
        poses[:, :3, 3] += late_s * velocities
    return with_bodies(plan.scene.world, poses, velocities)


def _shutter(
    plan: Plan, body_from_cam: Floats, rows: int, index: int, settings: Settings, late_s: float
) -> Shutter:
    """Poses of a camera, `late_s` after the first one, during the exposure of a frame."""
    return moving_shutter(
        lambda times_s: plan.path.world_from_body(times_s) @ body_from_cam,
        time_s=float(plan.path_s[index]) + late_s,
        rows=rows,
        exposure_s=settings.exposure_s,
        readout_s=readout_s(plan.recipe.effects, plan.recipe.fps),
    )
