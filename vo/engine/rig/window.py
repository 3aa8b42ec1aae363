"""The sliding window of a rig: keyframes are instants, each of one keyframe for every view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vo.base.config import SmoothingConfig, WindowSize
from vo.base.geometry.transforms import inverse, orthonormalised
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Floats, Ints
from vo.engine.backend.covariance import update_covariances
from vo.engine.backend.optimizer import WindowOptimizer
from vo.engine.backend.rig_extrinsics import ExtrinsicEvidence
from vo.engine.backend.sliding_window import SlidingWindow, Window, WindowUpdate
from vo.engine.backend.solution import WindowSolution
from vo.engine.backend.window_problem import Ties
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.rig.tracked import LastRigFrame

_FREE, _FIXED = 6, 6  # instants
_LANDMARKS = 400  # for each view


def rig_window_size(config: SmoothingConfig, body_from_views: Floats) -> WindowSize:
    """Instants that are optimised, fixed ones, and landmarks, for views (V, 4, 4).

    Views from one place have no scale, which then drifts as that of one camera does.
    """
    given = config.window, config.fixed, config.max_landmarks
    instants = (_FREE, _FIXED) if body_from_views[:, :3, 3].any() else config.size(is_metric=False)
    usual = *instants[:2], _LANDMARKS * len(body_from_views)
    return WindowSize(*(u if g is None else g for g, u in zip(given, usual, strict=True)))


class RigWindow(SlidingWindow):
    """Submits windows whose views are tied to the body.

    Attributes:
        metre: change of the length of a metre in the map by the newest result, and the information
            on that length.
        extrinsics: what the newest result says of them, where that was asked for.
    """

    def __init__(
        self,
        local_map: LocalMap,
        optimizer: WindowOptimizer,
        config: SmoothingConfig,
        stopwatch: Stopwatch,
        size: WindowSize,
        cameras: Ints,
        lever: Callable[[], tuple[Floats, float] | None],
    ) -> None:
        super().__init__(local_map, optimizer, 1.0, config, stopwatch)
        self._size = size
        self._latency = 2
        self._cameras, self._views = cameras, len(cameras)
        self._lever = lever
        self.metre = 0.0, 0.0
        self.extrinsics: ExtrinsicEvidence | None = None
        self._retied: tuple[Keyframe, Floats] | None = None  # until the next result

    def retie(self, before: LastRigFrame | None) -> None:
        """Place the views of the newest instant, if it is this frame, on its body anew."""
        first = self._map.keyframes[-self._views]
        if before is not None and first.frame.index == before.frame.index:
            self._retied = first, before.tracked.body_from_views
            self._place(*self._retied)

    def _place(self, first: Keyframe, tied: Floats) -> None:
        """Place the views (V, 4, 4) of the instant that begins with a keyframe."""
        body = first.world_from_cam
        for keyframe in self._map.keyframes:
            view = keyframe.id - first.id
            if 0 <= view < self._views:
                keyframe.world_from_cam = orthonormalised(body @ tied[view])

    def move_views(self, by: Floats, *, calibration_weight: int) -> WindowUpdate | None:
        """Fix the views (V, 4, 4) elsewhere on the body, and optimise the map; none is pending."""
        local_map, before, self._retied = self._map, self._map.poses, None
        for number, keyframe in enumerate(local_map.keyframes):
            moved = keyframe.world_from_cam @ by[number % self._views]
            keyframe.world_from_cam = orthonormalised(moved)
        everything = np.ones(len(local_map), dtype=bool)
        self._move_landmarks(before, everything)
        self._refine_landmarks(self._map_problem(np.zeros(len(before), bool)), everything)
        self.extrinsics = None
        self._submit(len(before) - self._views, calibration_weight)
        return self.apply()

    @timed("window")
    def submit(self, *, calibration_weight: int = 0) -> None:
        """Submit the newest instants; the result before must have been applied."""
        self.extrinsics = None
        instants = len(self._map.keyframes) // self._views
        self._submit(min(self._size.free, instants - 1) * self._views, calibration_weight)

    def _window(self, free: int, calibration_weight: int) -> Window | None:
        if len(self._map.keyframes) < 2 * self._views:
            return None
        window = super()._window(free, calibration_weight)
        assert window is not None
        poses, views = window.problem.world_from_cam, self._views
        tied = inverse(np.repeat(poses[::views], views, axis=0)) @ poses
        lever = self._lever()
        count = len(poses) // views
        ties = Ties(tied, views)
        if lever is not None:
            ties = Ties(tied, views, np.tile(lever[0], (count, 1)), lever[1])
        elif calibration_weight:
            ties = Ties(tied, views, cameras=self._cameras)
        return replace(window, problem=replace(window.problem, ties=ties))

    def _move_keyframes(self, window: Window, solution: WindowSolution) -> list[Keyframe]:
        """Move all views that the window has, and newer ones with them."""
        views, newest = self._views, window.keyframes[-self._views]
        before = newest.world_from_cam
        for keyframe, pose in zip(window.keyframes, solution.world_from_cam, strict=True):
            keyframe.world_from_cam = pose
        motion = orthonormalised(newest.world_from_cam @ inverse(before))
        ties = window.problem.ties
        lever = None if ties is None else ties.lever
        later = [k for k in self._map.keyframes if k.id > window.keyframes[-1].id]
        for first in range(0, len(later), views):
            body = later[first].world_from_cam
            for view, keyframe in enumerate(later[first : first + views]):
                tied = inverse(body) @ keyframe.world_from_cam
                if lever is not None:
                    tied[:3, 3] += solution.metre[0] * lever[view]
                keyframe.world_from_cam = orthonormalised(motion @ body @ tied)
        if self._retied is not None:
            retied, tied = self._retied
            if lever is not None:
                tied = tied.copy()
                tied[:, :3, 3] += solution.metre[0] * lever[:views]
            self._place(retied, tied)
            self._retied = None
        update_covariances(window.keyframes[::views], solution)
        self.metre, self.extrinsics = solution.metre, solution.extrinsics
        free = [
            k
            for k, is_held in zip(window.keyframes[::views], solution.held, strict=True)
            if not is_held
        ]
        return free + later[::views]
