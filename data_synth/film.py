"""Films a plan: renders each frame, and makes of its light what the sensor would."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from data_synth.plan import Plan
from data_synth.records import Shot
from data_synth.scene.bodies import with_bodies
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import Shutter, moving, still
from data_synth.scene.world import World
from data_synth.sensor.exposure import AutoExposure, Settings, readout_s
from data_synth.sensor.photometrics import develop, vignetting
from vo.geometry.transforms import inverse
from vo.types import Bytes, Camera, Floats, Floats32

_PREVIEW_STEP = 8
_SEED_NOISE = 2
_FRAMES_AT_ONCE = 2


@dataclass(frozen=True, eq=False)
class _Eye:
    """One camera, ready to film."""

    camera: Camera
    rays: Floats
    vignette: Floats32
    body_from_cam: Floats


_Taken = tuple[Bytes, Floats32 | None]  # image, and depth where it is kept


@dataclass(frozen=True, eq=False)
class _Exposed:
    """A frame whose images are being rendered and developed."""

    index: int
    images: tuple[Future[_Taken] | None, ...]

    def mean(self) -> float | None:
        """Mean of cam0's image, 0…1."""
        return None if self.images[0] is None else float(self.images[0].result()[0].mean()) / 255.0

    def shot(self) -> Shot:
        """The developed images."""
        done = tuple(None if image is None else image.result()[0] for image in self.images)
        depth = None if self.images[0] is None else self.images[0].result()[1]
        return Shot(self.index, done, depth)


def film(plan: Plan, pool: ThreadPoolExecutor, frames: range | None = None) -> Iterator[Shot]:
    """Render frames in order, both images of one and those of the next at the same time.

    So no core waits for the last rows of an image. A frame is exposed by the light of the frame
    before the last.

    Args:
        plan: what to film.
        pool: threads that share the rows of an image; their number changes no byte.
        frames: which frames, by default all; the first is exposed as its light asks for.
    """
    frames = range(len(plan.recording)) if frames is None else frames
    if len(frames) == 0:
        return
    eyes = _eyes(plan)
    effects, fps = plan.recipe.effects, plan.recipe.fps
    auto = AutoExposure(effects, fps, _preview_mean(plan, eyes[0], frames[0], pool))
    before: _Exposed | None = None
    # Their threads only wait for those of the pool, which never wait.
    with ThreadPoolExecutor(_FRAMES_AT_ONCE * len(eyes), thread_name_prefix="film") as images:
        for index in frames:
            exposed = _expose(plan, eyes, index, auto.next(), images, pool)
            if before is not None:
                auto.observe(before.mean())
                yield before.shot()
            before = exposed
        if before is not None:
            yield before.shot()


def _eyes(plan: Plan) -> tuple[_Eye, ...]:
    rig, strength = plan.recording.rig, plan.recipe.effects.vignetting
    placed = [(rig.cam0, plan.recording.body_from_cam0)]
    if rig.cam1 is not None and rig.cam1_from_cam0 is not None:
        body_from_cam1 = plan.recording.body_from_cam0 @ inverse(rig.cam1_from_cam0)
        placed.append((rig.cam1, body_from_cam1))
    return tuple(
        _Eye(camera, camera_rays(camera), vignetting(camera, strength), body_from_cam)
        for camera, body_from_cam in placed
    )


def _preview_mean(plan: Plan, eye: _Eye, index: int, pool: ThreadPoolExecutor) -> float:
    """Mean light of a view, at a fraction of the pixels."""
    step = _PREVIEW_STEP
    world_from_body = plan.path.world_from_body(plan.timing.times_s[index : index + 1])[0]
    rays = np.ascontiguousarray(eye.rays[::step, ::step])
    view = render(_world(plan, index), rays, still(world_from_body @ eye.body_from_cam), pool)
    return float((view.image * eye.vignette[::step, ::step]).mean())


def _expose(
    plan: Plan,
    eyes: tuple[_Eye, ...],
    index: int,
    settings: Settings,
    images: ThreadPoolExecutor,
    pool: ThreadPoolExecutor,
) -> _Exposed:
    """Begin to render and develop a frame."""
    world, dropped = _world(plan, index), plan.timing.dropped

    def take(number: int) -> _Taken:
        view = render(world, eyes[number].rays, _shutter(plan, eyes[number], index, settings), pool)
        image = develop(
            view.image,
            settings,
            plan.recipe.effects,
            float(plan.timing.illumination[index]),
            eyes[number].vignette,
            np.random.default_rng([plan.recipe.seed, _SEED_NOISE, index, number]),
        )
        return image, view.depth if number == 0 and plan.recording.has_depth else None

    return _Exposed(
        index,
        tuple(
            None if dropped[number][index] else images.submit(take, number)
            for number in range(len(eyes))
        ),
    )


def _world(plan: Plan, index: int) -> World:
    """The world with everything that moves at its place in the middle of the frame's exposure."""
    if plan.mover_poses.shape[1] == 0:
        return plan.scene.world
    return with_bodies(plan.scene.world, plan.mover_poses[index], plan.mover_velocities[index])


def _shutter(plan: Plan, eye: _Eye, index: int, settings: Settings) -> Shutter:
    """The way of a camera from the first moment of its first row to the last of its last."""
    return moving(
        lambda times_s: plan.path.world_from_body(times_s) @ eye.body_from_cam,
        time_s=float(plan.timing.times_s[index]),
        rows=eye.camera.height,
        exposure_s=settings.exposure_s,
        readout_s=readout_s(plan.recipe.effects, plan.recipe.fps),
    )
