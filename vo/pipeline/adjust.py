"""The map's newest keyframes as a window for the smoother, and its answer back into the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.config import Config
from vo.geometry.points import refine_points
from vo.geometry.rectification import WorkingRig
from vo.geometry.transforms import adjoint, inverse
from vo.mapping.map import Keyframe, Map
from vo.smoothing.disparity_offset import DisparityOffset, disparity_offset
from vo.smoothing.window import residuals, smooth
from vo.types import Bools, Floats, Ints, WindowProblem


def adjust(
    world: Map, rig: WorkingRig, config: Config, *, whole_map: bool = False
) -> tuple[list[Keyframe], DisparityOffset | None]:
    """Smooth the window, write poses and points back, drop what disagrees.

    With `whole_map` every keyframe of the map but the first may move, not only the window's.

    Returns:
        The keyframes whose pose was adjusted, and in stereo the window's view of the disparity
        offset that is left.
    """
    keyframes = world.keyframes
    if len(keyframes) < 2:
        keyframes[0].covariance = np.zeros((6, 6))
        return [], None
    free = len(keyframes) - 1 if whole_map else min(config.smoothing.window, len(keyframes) - 1)
    fixed = np.arange(len(keyframes)) < len(keyframes) - free
    everything = _everything(world, rig, fixed)
    chosen = _chosen(everything, config)
    window, rows = _restricted(everything, chosen)
    solution = smooth(window, config.smoothing)
    if not solution.converged:
        return [], None
    offset = None
    if rig.is_stereo and config.stereo.offset_correction:
        offset = disparity_offset(window, solution, config.smoothing)
    anchor = keyframes[int(np.flatnonzero(fixed)[-1])]
    for k in np.flatnonzero(~fixed):
        keyframes[k].world_from_cam = solution.world_from_cam[k]
        keyframes[k].covariance = _chained(anchor, keyframes[k], solution.covariance[k])
    world.xyz[rows] = solution.points
    _refine_others(world, everything, ~chosen, solution.world_from_cam, config)
    degenerate = np.zeros(len(world), dtype=bool)
    degenerate[rows] = ~solution.point_ok
    _drop_outliers(world, everything, solution.world_from_cam, degenerate, config)
    return [k for k, f in zip(keyframes, fixed, strict=True) if not f], offset


def cull(world: Map, config: Config) -> None:
    """Drop landmarks that are rarely found, or that too few keyframes see to hold them."""
    newest = world.keyframes[-1].id
    seen = np.zeros(len(world), dtype=np.int64)
    measured = np.zeros(len(world), dtype=bool)
    for keyframe in world.keyframes:
        rows = world.rows(keyframe.landmark)
        seen[rows] += 1
        measured[rows] |= ~np.isnan(keyframe.disparity)
    rarely = world.found < config.mapping.min_found_share * world.visible
    # Two views (or left and right of one) hold a landmark for a while, three for good.
    weak = (seen < 2) & ~(measured & (world.last_seen >= newest - 1))
    world.keep_landmarks((seen > 0) & ~rarely & ~weak)


def _everything(world: Map, rig: WorkingRig, fixed: Bools) -> WindowProblem:
    """All keyframes, landmarks and observations of the map; its points are the map's rows."""
    keyframes = world.keyframes
    return WindowProblem(
        intrinsics=(rig.fx, rig.fy, rig.cx, rig.cy),
        baseline_m=rig.baseline_m,
        world_from_cam=np.stack([k.world_from_cam for k in keyframes]),
        fixed=fixed,
        points=world.xyz,
        keyframe=np.repeat(np.arange(len(keyframes)), [len(k.landmark) for k in keyframes]),
        point=np.concatenate([world.rows(k.landmark) for k in keyframes]),
        xy=np.concatenate([k.xy for k in keyframes]),
        disparity=np.concatenate([k.disparity for k in keyframes]),
        sigma_px=np.concatenate([k.sigma_px for k in keyframes]),
    )


def _restricted(problem: WindowProblem, chosen: Bools) -> tuple[WindowProblem, Ints]:
    """The same with the chosen points (M,) only, and their rows in the whole."""
    used = chosen[problem.point]
    place = np.cumsum(chosen) - 1
    restricted = replace(
        problem,
        points=problem.points[chosen],
        keyframe=problem.keyframe[used],
        point=place[problem.point[used]],
        xy=problem.xy[used],
        disparity=problem.disparity[used],
        sigma_px=problem.sigma_px[used],
    )
    return restricted, np.flatnonzero(chosen)


def _chosen(problem: WindowProblem, config: Config) -> Bools:
    """Mask (M,) of the landmarks that take part in the window.

    They are ranked within each keyframe, most seen first, and taken by their best rank. That gives
    every keyframe its share, also one that has just turned to a part of the scene that no other
    keyframe has seen for long.
    """
    count = len(problem.points)
    seen = np.bincount(problem.point, minlength=count)
    moves = ~problem.fixed[problem.keyframe]
    seen_by_free = np.bincount(problem.point[moves], minlength=count)
    best = np.full(count, np.iinfo(np.int64).max)
    for k in range(len(problem.world_from_cam)):
        mine = problem.point[problem.keyframe == k]
        order = mine[np.argsort(-seen[mine], kind="stable")]
        best[order] = np.minimum(best[order], np.arange(len(order)))
    candidates = np.flatnonzero((seen >= 2) & (seen_by_free >= 1))
    order = np.lexsort((-seen[candidates], best[candidates]))[: config.smoothing.max_landmarks]
    chosen = np.zeros(count, dtype=bool)
    chosen[candidates[order]] = True
    return chosen


def _refine_others(
    world: Map, everything: WindowProblem, others: Bools, world_from_cam: Floats, config: Config
) -> None:
    """Bring landmarks that took no part in the window into line with the adjusted poses.

    They were triangulated from poses that have moved since, all in the same wrong way.
    """
    rest, rows = _restricted(everything, others)
    world.xyz[rows] = refine_points(
        rest.points,
        inverse(world_from_cam),
        rest.point,
        rest.keyframe,
        rest.xy,
        rest.disparity,
        rest.sigma_px,
        config.smoothing.sigma_disparity_px,
        rest.intrinsics,
        rest.intrinsics[0] * rest.baseline_m,
        huber=config.smoothing.huber,
    )


def _drop_outliers(
    world: Map,
    everything: WindowProblem,
    world_from_cam: Floats,
    degenerate: Bools,
    config: Config,
) -> None:
    """Forget observations that disagree, and all those of degenerate landmarks."""
    sigma_px = config.smoothing.sigma_disparity_px
    residual, _ = residuals(everything, world_from_cam, world.xyz, sigma_px)
    kept = (residual <= config.smoothing.gate) & ~degenerate[everything.point]
    for k, keyframe in enumerate(world.keyframes):
        keyframe.keep_observations(kept[everything.keyframe == k])


def _chained(anchor: Keyframe, keyframe: Keyframe, relative: np.ndarray) -> np.ndarray | None:
    """Covariance against the start: that of the anchor carried over, plus that since the anchor.

    Source: Barfoot 2017, sec. 7.3.3 (compounding, first order).
    """
    if anchor.covariance is None or not np.isfinite(relative).all():
        return None
    carry = adjoint(inverse(keyframe.world_from_cam) @ anchor.world_from_cam)
    return np.asarray(carry @ anchor.covariance @ carry.T + relative)
