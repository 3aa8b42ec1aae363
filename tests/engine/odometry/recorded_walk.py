"""A rendered walk through a room, and runs of the odometry on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from vo.base.config import Config, FeaturesConfig
from vo.base.geometry.similarity import Similarity, umeyama
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats, Frame, Rig, State
from vo.engine.odometry import Odometry

FPS, FIRST, COUNT = 15.0, 15, 40  # a second after the start, when the walk is under way
CONFIG = Config(threads=1, features=FeaturesConfig(count=800))  # enough for small images
Change = Callable[[Frame], Frame]


@dataclass(frozen=True, eq=False)
class Recording:
    """A stereo walk through a room with its true poses."""

    rig: Rig
    frames: tuple[Frame, ...]
    world_from_cam0: Floats

    @property
    def mono_rig(self) -> Rig:
        return Rig(self.rig.cam0)

    def mono(self) -> list[Frame]:
        return [replace(f, images=f.images[:1]) for f in self.frames]

    @property
    def path_m(self) -> float:
        steps = np.diff(self.world_from_cam0[:, :3, 3], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())


@dataclass(frozen=True, eq=False)
class Run:
    """Results of the odometry, frame by frame, and its path at the end."""

    odometry: Odometry
    estimates: list[Estimate]
    snapshots: list[Snapshot]  # empty unless they were asked for

    @property
    def states(self) -> list[State]:
        return [e.state for e in self.estimates]

    @property
    def path(self) -> Floats:
        return self.odometry.trajectory.trajectory().world_from_cam

    @property
    def numbers(self) -> list[int]:
        """Frames that have a pose."""
        return [int(f) for f in self.odometry.trajectory.frames["frame_index"]]

    def segment(self, number: int) -> list[int]:
        frames = self.odometry.trajectory.frames
        return [int(f) for f in frames["frame_index"][frames["segment"] == number]]


def rendered_recording() -> Recording:
    settings = ["effects.exposure=0", "effects.blur=0", "effects.vignetting=0"]
    recipe = load_recipe("demo", [*settings, "motion=handheld", "seconds=4", "scale=0.75"])
    plan = make_plan(recipe)
    frames = []
    with ThreadPoolExecutor() as pool:
        for shot in render_frames(plan, pool, range(FIRST, FIRST + COUNT)):
            index = len(frames)
            left, right = shot.images
            assert left is not None
            frames.append(Frame(index, round(index / FPS * 1e9), (left, right)))
    poses = plan.recording.cam0_truth.world_from_cam[FIRST : FIRST + COUNT]
    return Recording(plan.recording.rig, tuple(frames), poses)


def track(
    rig: Rig, frames: Iterable[Frame], config: Config = CONFIG, *, takes_snapshots: bool = False
) -> Run:
    odometry = Odometry(rig, config)
    run = Run(odometry, [], [])
    for estimate in odometry.track_all(frames):
        assert (estimate.state is State.TRACKING) == (estimate.world_from_cam0 is not None)
        run.estimates.append(estimate)
        if takes_snapshots:
            run.snapshots.append(odometry.snapshot())
    odometry.finish()
    odometry.close()
    return run


def aligned(run: Run, recording: Recording, *, with_scale: bool) -> tuple[float, Similarity]:
    """Root mean square of position errors after alignment, and the alignment."""
    truth = recording.world_from_cam0[run.numbers][:, :3, 3]
    fit = umeyama(run.path[:, :3, 3], truth, with_scale=with_scale)
    errors = fit.transform_points(run.path[:, :3, 3]) - truth
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))), fit


def changed(frames: Iterable[Frame], numbers: Iterable[int], change: Change) -> list[Frame]:
    chosen = set(numbers)
    return [change(f) if f.index in chosen else f for f in frames]


def black(frame: Frame) -> Frame:
    dark = np.zeros_like(frame.image0)
    return replace(frame, images=(dark, None if frame.image1 is None else dark))
