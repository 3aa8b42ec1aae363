"""Sliding-window optimisation of the newest keyframes, and its result in the local map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.config import SmoothingConfig
from vo.base.frozen import frozen
from vo.base.geometry.transforms import inverse, orthonormalised
from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.bundle import views_of
from vo.engine.backend.covariance import update_covariances
from vo.engine.backend.landmark_selection import choose_landmarks
from vo.engine.backend.optimizer import WindowOptimizer
from vo.engine.backend.residuals import residuals
from vo.engine.backend.solution import WindowSolution
from vo.engine.backend.window_problem import FactorSource, WindowProblem
from vo.engine.geometry.points import best_points
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap

# A result is applied when the next keyframe is made, or else once this many further frames have
# been tracked and the next one has come. The number is fixed, so
# that the path does not depend on the speed of the optimizer. With one camera the landmarks' depths
# depend on the poses, and the result is needed earlier.
_LATENCY_STEREO, _LATENCY_MONO = 2, 1


@frozen(eq=False)
class Window:
    """A submitted window, and what the rows of its problem stand for.

    Attributes:
        landmarks: (M,) ids of its points.
        calibration_weight: weight of its calibration residual, 0 if it is not estimated.
    """

    problem: WindowProblem
    keyframes: tuple[Keyframe, ...]
    landmarks: Ints
    calibration_weight: int


@frozen(eq=False)
class WindowUpdate:
    """A result that was applied to the map.

    Attributes:
        calibration_residual: None if it is not determined, or not estimated.
    """

    window: Window
    moved: list[Keyframe]
    calibration_residual: CalibrationResidual | None

    def motion_until_now(self) -> Floats:
        """(4, 4) motion of the window's newest keyframe in the world since the submission."""
        newest = self.window.keyframes[-1]
        return np.asarray(newest.world_from_cam @ inverse(self.window.problem.world_from_cam[-1]))


class SlidingWindow:
    """Submits windows of the map to an optimizer, one at a time, and applies their results.

    Attributes:
        submitted: number of windows submitted so far, without those of the whole map.
    """

    def __init__(
        self,
        local_map: LocalMap,
        optimizer: WindowOptimizer,
        sigma_disparity_px: float,
        config: SmoothingConfig,
        stopwatch: Stopwatch,
        factor_sources: Sequence[FactorSource] = (),
    ) -> None:
        self.submitted = 0
        self.stopwatch = stopwatch
        self._map = local_map
        self._optimizer = optimizer
        self._sigma_disparity_px = sigma_disparity_px
        self._config = config
        self._factor_sources = factor_sources
        self._size = config.size(is_metric=local_map.rig.is_metric)
        self._latency = _LATENCY_STEREO if local_map.rig.is_metric else _LATENCY_MONO
        self._pending: Window | None = None
        self._frames_since = 0  # the last submission

    def next_frame(self) -> bool:
        """Count a frame; whether the pending result is due."""
        self._frames_since += 1
        return self._pending is not None and self._frames_since > self._latency

    @timed("window")
    def submit(self, *, calibration_weight: int) -> None:
        """Submit the newest keyframes; the result before must have been applied."""
        keyframes = self._map.keyframes
        free = min(self._size.free, len(keyframes) - 1)
        self._submit(free, calibration_weight)
        self.submitted += self._pending is not None

    @timed("window")
    def optimise_map(self) -> WindowUpdate | None:
        """Optimise all keyframes of the map but the first, and apply the result."""
        self._submit(len(self._map.keyframes) - 1, 0)
        return self.apply()

    @timed("window")
    def apply(self) -> WindowUpdate | None:
        """Wait for the pending result, if there is one, and apply it to the map."""
        if self._pending is None:
            return None
        window, self._pending = self._pending, None
        solution = self._wait()
        moved = self.apply_solution(window, solution)
        return WindowUpdate(window, moved, solution.calibration_residual)

    @timed("smooth")
    def _wait(self) -> WindowSolution:
        return self._optimizer.result()

    def _submit(self, free: int, calibration_weight: int) -> None:
        window = self._window(free, calibration_weight)
        if window is not None:
            self._optimizer.submit(window.problem)
        self._pending, self._frames_since = window, 0

    def _window(self, free: int, calibration_weight: int) -> Window | None:
        """The newest `free` keyframes, with fixed ones before them; None if there is only one."""
        keyframes = tuple(self._map.keyframes)
        if len(keyframes) < 2:
            return None
        fixed = np.arange(len(keyframes)) < len(keyframes) - free
        whole = self._map_problem(fixed)
        chosen = choose_landmarks(whole, self._size.landmarks)
        problem, rows = _restricted(whole, chosen)
        factors = [f for source in self._factor_sources for f in source.factors(keyframes)]
        known = [keyframe.covariance is not None for keyframe in keyframes[: len(keyframes) - free]]
        problem = replace(
            problem,
            estimates_calibration=calibration_weight > 0,
            factors=tuple(factors),
            is_fixed_known=all(known),
        )
        return Window(problem, keyframes, self._map.id[rows], calibration_weight)

    def apply_solution(self, window: Window, solution: WindowSolution) -> list[Keyframe]:
        """Write poses and points into the map as it is now; remove what disagrees.

        Newer keyframes move with the window's newest, and landmarks outside of the window with the
        keyframe of their patch; these are then fitted to the new poses. Returns the keyframes whose
        pose has changed.
        """
        if not solution.converged:
            return []
        local_map = self._map
        before = local_map.poses
        moved = self._move_keyframes(window, solution)
        rows = local_map.rows(window.landmarks)
        there = rows >= 0
        in_window = np.zeros(len(local_map), dtype=bool)
        in_window[rows[there]] = True
        self._move_landmarks(before, ~in_window)
        local_map.xyz[rows[there]] = solution.points[there]
        whole = self._map_problem(np.zeros(len(local_map.keyframes), dtype=bool))
        self._refine_landmarks(whole, ~in_window)
        degenerate = np.zeros(len(local_map), dtype=bool)
        degenerate[rows[there]] = ~solution.point_ok[there]
        self._remove_outliers(whole, window.keyframes[-1], degenerate)
        for source in self._factor_sources:
            source.update(window.keyframes, solution.states)
        return moved

    def _move_keyframes(self, window: Window, solution: WindowSolution) -> list[Keyframe]:
        newest = window.keyframes[-1]
        motion = orthonormalised(solution.world_from_cam[-1] @ inverse(newest.world_from_cam))
        moved = [k for k in self._map.keyframes if k.id > newest.id]
        for keyframe in moved:
            # Products with transposed rotations double the rounding error each time.
            keyframe.world_from_cam = orthonormalised(motion @ keyframe.world_from_cam)
        free = np.flatnonzero(~window.problem.fixed).tolist()
        for k in free:
            window.keyframes[k].world_from_cam = solution.world_from_cam[k]
        update_covariances(window.keyframes, solution)
        return [window.keyframes[k] for k in free] + moved

    def _move_landmarks(self, before: Floats, mask: Bools) -> None:
        """Move landmarks with the keyframes of their patches, whose poses were `before`."""
        local_map = self._map
        motion = local_map.poses @ inverse(before)
        by = local_map.reference - local_map.keyframes[0].id
        _move_each(local_map.xyz, mask, motion, by)

    def _map_problem(self, fixed: Bools) -> WindowProblem:
        """All keyframes, landmarks and observations; its points are the map's rows."""
        keyframes, rig = self._map.keyframes, self._map.rig
        number, row = self._map.observation_rows()
        return WindowProblem(
            intrinsics=rig.intrinsics,
            baseline_m=rig.baseline_m,
            sigma_disparity_px=self._sigma_disparity_px,
            world_from_cam=self._map.poses,
            fixed=fixed,
            points=self._map.xyz,
            keyframe=number,
            point=row,
            xy=np.concatenate([k.xy for k in keyframes]),
            disparity=np.concatenate([k.disparity for k in keyframes]),
            sigma_px=np.concatenate([k.sigma_px for k in keyframes]),
        )

    def _refine_landmarks(self, whole: WindowProblem, mask: Bools) -> None:
        """Fit landmarks outside of the window to the new poses.

        They were triangulated from poses that have since moved, all by a similar error.
        """
        views = views_of(whole, mask, self._config)
        cam_from_world = inverse(whole.world_from_cam)
        self._map.xyz, _ = best_points(self._map.xyz, cam_from_world, views)

    def _remove_outliers(self, whole: WindowProblem, newest: Keyframe, degenerate: Bools) -> None:
        """Remove observations with large residuals, and all those of degenerate landmarks.

        Keyframes newer than `newest` have not been optimised and are not judged yet.
        """
        residual = residuals(whole, whole.world_from_cam, self._map.xyz).length
        judged = whole.keyframe <= newest.id - self._map.keyframes[0].id
        removed = degenerate[whole.point] | (judged & ~(residual <= self._config.gate))
        begin = 0
        for keyframe in self._map.keyframes:
            end = begin + len(keyframe.landmark)
            keyframe.keep_observations(~removed[begin:end])
            begin = end


@compiled
def _move_each(points, mask, motion, by):  # type: ignore[no-untyped-def]
    """Transform the points of a mask (M,), in place, each by the motion of its row (M,)."""
    for n in range(len(points)):
        if mask[n]:
            t = motion[by[n]]
            x, y, z = points[n]
            for i in range(3):  # sums in the order in which numpy adds them
                points[n, i] = t[i, 0] * x + t[i, 2] * z + t[i, 1] * y + t[i, 3]


def _restricted(problem: WindowProblem, chosen: Bools) -> tuple[WindowProblem, Ints]:
    """The problem with the chosen points (M,) only, and their rows."""
    used, rows = np.flatnonzero(chosen[problem.point]), np.flatnonzero(chosen)
    place = np.cumsum(chosen) - 1
    restricted = replace(
        problem,
        points=problem.points.take(rows, axis=0),
        keyframe=problem.keyframe.take(used),
        point=place[problem.point.take(used)],
        xy=problem.xy.take(used, axis=0),
        disparity=problem.disparity.take(used),
        sigma_px=problem.sigma_px.take(used),
    )
    return restricted, rows
