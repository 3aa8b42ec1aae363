"""The map's newest keyframes as a window for the smoother, and its answer back into the map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vo.backend.bundle import views_of
from vo.backend.landmark_selection import choose_landmarks
from vo.backend.path_covariance import update_covariances
from vo.backend.residuals import residuals
from vo.backend.solution import WindowSolution
from vo.config import Config
from vo.geometry.points import best_points
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import inverse, orthonormalised
from vo.mapping.local_map import Keyframe, Map
from vo.types import Bools, Floats, Ints, WindowProblem


@dataclass(frozen=True, eq=False)
class Window:
    """A window that was handed to the smoother, and what its rows stand for.

    Attributes:
        problem: the window.
        keyframes: of each of its poses, the newest last.
        landmarks: (M,) ids of its points.
        speaks_for: how many windows there are for each that tells of the calibration, 0 if it is
            not asked.
    """

    problem: WindowProblem
    keyframes: tuple[Keyframe, ...]
    landmarks: Ints
    speaks_for: int


def make_window(
    world: Map,
    rig: RectifiedRig,
    config: Config,
    *,
    whole_map: bool = False,
    speaks_for: int = 1,
) -> Window | None:
    """The map's newest keyframes and the landmarks that hold them best; None of one keyframe.

    With `whole_map` every keyframe of the map but the first may move, not only the window's.
    """
    keyframes = world.keyframes
    if len(keyframes) < 2:
        return None
    free = len(keyframes) - 1 if whole_map else min(config.smoothing.window, len(keyframes) - 1)
    fixed = np.arange(len(keyframes)) < len(keyframes) - free
    everything = _everything(world, rig, fixed)
    chosen = choose_landmarks(everything, config.smoothing.max_landmarks)
    problem, rows = _restricted(everything, chosen)
    problem = replace(problem, calibrates=speaks_for > 0)
    return Window(problem, tuple(keyframes), world.id[rows], speaks_for)


def take_in(
    world: Map, window: Window, solution: WindowSolution, rig: RectifiedRig, config: Config
) -> list[Keyframe]:
    """Write a window's poses and points into the map as it is now; drop what disagrees.

    Keyframes that were made since are carried along with the window's newest, landmarks that took
    no part with the keyframe of their patch; then these are fitted to the new poses.

    Returns:
        The keyframes whose pose has changed.
    """
    if not solution.converged:
        return []
    before = np.stack([k.world_from_cam for k in world.keyframes])
    moved = _move_keyframes(world, window, solution)
    rows = world.rows(window.landmarks)
    there = rows >= 0
    took_part = np.zeros(len(world), dtype=bool)
    took_part[rows[there]] = True
    _carry_landmarks(world, before, ~took_part)
    world.xyz[rows[there]] = solution.points[there]
    everything = _everything(world, rig, np.zeros(len(world.keyframes), dtype=bool))
    _refine(world, everything, ~took_part, config)
    degenerate = np.zeros(len(world), dtype=bool)
    degenerate[rows[there]] = ~solution.point_ok[there]
    _drop_outliers(world, everything, window.keyframes[-1], degenerate, config)
    return moved


def _move_keyframes(world: Map, window: Window, solution: WindowSolution) -> list[Keyframe]:
    newest = window.keyframes[-1]
    motion = orthonormalised(solution.world_from_cam[-1] @ inverse(newest.world_from_cam))
    moved = [k for k in world.keyframes if k.id > newest.id]
    for keyframe in moved:
        # Rounding must not add up: products with transposed rotations double it each time.
        keyframe.world_from_cam = orthonormalised(motion @ keyframe.world_from_cam)
    free = np.flatnonzero(~window.problem.fixed)
    for k in free.tolist():
        keyframe = window.keyframes[k]
        keyframe.world_from_cam = solution.world_from_cam[k]
    update_covariances(window.keyframes, solution)
    return [window.keyframes[k] for k in free] + moved


def _carry_landmarks(world: Map, before: Floats, carried: Bools) -> None:
    """Move landmarks with the keyframes of their patches, whose poses were others `before`."""
    now = np.stack([k.world_from_cam for k in world.keyframes])
    motion = now @ inverse(before)
    rows = np.flatnonzero(carried)
    by = motion[world.reference[rows] - world.keyframes[0].id]
    turned = np.einsum("nij,nj->ni", by[:, :3, :3], world.xyz[rows])
    world.xyz[rows] = turned + by[:, :3, 3]


def cull(world: Map, config: Config) -> None:
    """Drop landmarks that are rarely found, or that too few keyframes see to hold them."""
    newest = world.keyframes[-1].id
    _, row = world.sightings()
    disparity = np.concatenate([k.disparity for k in world.keyframes])
    seen = np.bincount(row, minlength=len(world))
    measured = np.zeros(len(world), dtype=bool)
    measured[row[~np.isnan(disparity)]] = True
    rarely = world.found < config.mapping.min_found_share * world.visible
    # Two views (or left and right of one) hold a landmark for a while, three for good.
    weak = (seen < 2) & ~(measured & (world.last_seen >= newest - 1))
    world.keep_landmarks((seen > 0) & ~rarely & ~weak)


def _everything(world: Map, rig: RectifiedRig, fixed: Bools) -> WindowProblem:
    """All keyframes, landmarks and observations of the map; its points are the map's rows."""
    keyframes = world.keyframes
    number, row = world.sightings()
    return WindowProblem(
        intrinsics=(rig.fx, rig.fy, rig.cx, rig.cy),
        baseline_m=rig.baseline_m,
        world_from_cam=np.stack([k.world_from_cam for k in keyframes]),
        fixed=fixed,
        points=world.xyz,
        keyframe=number,
        point=row,
        xy=np.concatenate([k.xy for k in keyframes]),
        disparity=np.concatenate([k.disparity for k in keyframes]),
        sigma_px=np.concatenate([k.sigma_px for k in keyframes]),
    )


def _restricted(problem: WindowProblem, chosen: Bools) -> tuple[WindowProblem, Ints]:
    """The same with the chosen points (M,) only, and their rows in the whole."""
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


def _refine(world: Map, everything: WindowProblem, chosen: Bools, config: Config) -> None:
    """Bring landmarks that took no part in a window into line with the adjusted poses.

    They were triangulated from poses that have moved since, all in the same wrong way.
    """
    views = views_of(everything, chosen, config.smoothing)
    world.xyz, _ = best_points(world.xyz, inverse(everything.world_from_cam), views)


def _drop_outliers(
    world: Map, everything: WindowProblem, newest: Keyframe, degenerate: Bools, config: Config
) -> None:
    """Forget observations that disagree, and all those of degenerate landmarks.

    Keyframes newer than `newest` have not been smoothed and are not judged yet.
    """
    sigma_px = config.smoothing.sigma_disparity_px
    residual, _ = residuals(everything, everything.world_from_cam, world.xyz, sigma_px)
    judged = everything.keyframe <= newest.id - world.keyframes[0].id
    dropped = degenerate[everything.point] | (judged & ~(residual <= config.smoothing.gate))
    begin = 0
    for keyframe in world.keyframes:
        end = begin + len(keyframe.landmark)
        keyframe.keep_observations(~dropped[begin:end])
        begin = end
