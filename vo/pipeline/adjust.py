"""The map's newest keyframes as a window for the smoother, and its answer back into the map."""

from __future__ import annotations

import numpy as np

from vo.config import Config
from vo.geometry.points import refine_points
from vo.geometry.rectification import WorkingRig
from vo.geometry.transforms import adjoint, inverse
from vo.mapping.map import Keyframe, Map
from vo.smoothing.disparity_offset import DisparityOffset, disparity_offset
from vo.smoothing.window import smooth
from vo.types import Bools, Ints, WindowProblem


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
    problem, rows = _window(world, rig, keyframes, fixed, config)
    solution = smooth(problem, config.smoothing)
    if not solution.converged:
        return [], None
    offset = None
    if rig.is_stereo and config.stereo.offset_correction:
        offset = disparity_offset(problem, solution, config.smoothing)
    anchor = keyframes[int(np.flatnonzero(fixed)[-1])]
    for k in np.flatnonzero(~fixed):
        keyframes[k].world_from_cam = solution.world_from_cam[k]
        keyframes[k].covariance = _chained(anchor, keyframes[k], solution.covariance[k])
    world.xyz[rows] = solution.points
    _refine_others(world, rig, rows, config)
    wrong = (solution.residual > config.smoothing.gate) | ~solution.point_ok[problem.point]
    _drop_observations(world, keyframes, problem, rows, wrong)
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


def _window(
    world: Map, rig: WorkingRig, keyframes: list[Keyframe], fixed: Bools, config: Config
) -> tuple[WindowProblem, Ints]:
    rows = [world.rows(k.landmark) for k in keyframes]
    seen = np.bincount(np.concatenate(rows), minlength=len(world))
    free_rows = [r for r, f in zip(rows, fixed, strict=True) if not f]
    seen_free = np.bincount(np.concatenate(free_rows), minlength=len(world))
    candidates = np.flatnonzero((seen >= 2) & (seen_free >= 1))
    rank = _best_rank(rows, seen, len(world))[candidates]
    order = np.lexsort((-seen[candidates], rank))[: config.smoothing.max_landmarks]
    chosen = np.sort(candidates[order])
    point_of = np.full(len(world), -1)
    point_of[chosen] = np.arange(len(chosen))
    point = np.concatenate([point_of[r] for r in rows])
    keyframe = np.repeat(np.arange(len(keyframes)), [len(r) for r in rows])
    used = point >= 0
    problem = WindowProblem(
        intrinsics=(rig.fx, rig.fy, rig.cx, rig.cy),
        baseline_m=rig.baseline_m,
        world_from_cam=np.stack([k.world_from_cam for k in keyframes]),
        fixed=fixed,
        points=world.xyz[chosen],
        keyframe=keyframe[used],
        point=point[used],
        xy=np.concatenate([k.xy for k in keyframes])[used],
        disparity=np.concatenate([k.disparity for k in keyframes])[used],
        sigma_px=np.concatenate([k.sigma_px for k in keyframes])[used],
    )
    return problem, chosen


def _best_rank(rows: list[Ints], seen: Ints, count: int) -> Ints:
    """The place of each landmark among those of a keyframe, most seen first; its best place.

    Taking landmarks by this place gives every keyframe its share of them, also one that has just
    turned to a part of the scene that no other keyframe has seen for long.
    """
    best = np.full(count, np.iinfo(np.int64).max)
    for mine in rows:
        order = mine[np.argsort(-seen[mine], kind="stable")]
        best[order] = np.minimum(best[order], np.arange(len(order)))
    return best


def _refine_others(world: Map, rig: WorkingRig, chosen: Ints, config: Config) -> None:
    """Bring landmarks that took no part in the window into line with the adjusted poses.

    They were triangulated from poses that have moved since, all in the same wrong way.
    """
    keyframes = world.keyframes
    rows = np.concatenate([world.rows(k.landmark) for k in keyframes])
    camera = np.repeat(np.arange(len(keyframes)), [len(k.landmark) for k in keyframes])
    others = np.ones(len(world), dtype=bool)
    others[chosen] = False
    used = others[rows]
    place = np.cumsum(others) - 1
    world.xyz[others] = refine_points(
        world.xyz[others],
        inverse(np.stack([k.world_from_cam for k in keyframes])),
        place[rows[used]],
        camera[used],
        np.concatenate([k.xy for k in keyframes])[used],
        np.concatenate([k.disparity for k in keyframes])[used],
        np.concatenate([k.sigma_px for k in keyframes])[used],
        config.smoothing.sigma_disparity_px,
        (rig.fx, rig.fy, rig.cx, rig.cy),
        rig.fx * rig.baseline_m,
        huber=config.smoothing.huber,
    )


def _chained(anchor: Keyframe, keyframe: Keyframe, relative: np.ndarray) -> np.ndarray | None:
    """Covariance against the start: that of the anchor carried over, plus that since the anchor.

    Source: Barfoot 2017, sec. 7.3.3 (compounding, first order).
    """
    if anchor.covariance is None or not np.isfinite(relative).all():
        return None
    carry = adjoint(inverse(keyframe.world_from_cam) @ anchor.world_from_cam)
    return np.asarray(carry @ anchor.covariance @ carry.T + relative)


def _drop_observations(
    world: Map, keyframes: list[Keyframe], problem: WindowProblem, rows: Ints, wrong: Bools
) -> None:
    for k, keyframe in enumerate(keyframes):
        mine = problem.keyframe == k
        bad_ids = world.id[rows[problem.point[mine & wrong]]]
        if len(bad_ids):
            keyframe.keep_observations(~np.isin(keyframe.landmark, bad_ids))
