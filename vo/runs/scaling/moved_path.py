"""Keyframes of a run moved by positions of another sensor, once, after its last frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.records.metric_scale import PositionUse
from vo.base.types import Floats, Ints
from vo.engine.geometry import sim3
from vo.engine.places.records import Loop
from vo.engine.trajectory.store import TrajectoryStore
from vo.runs.scaling.path_fusion import Fixes, FusedPath, LoopFactors, fuse_positions
from vo.runs.scaling.position_source import PathAlignment, PositionSource
from vo.runs.scaling.timed_fit import associate

_MAX_LOOPS = 16
_LOG_SCALE = 1e-4  # standard deviation that the scale of a loop has at least
_ROUNDED = 12.0**-0.5
_HELD_M = 0.1  # way of the camera between two positions that are equal to the last digit
_USUAL_RATIO = (0.2, 5.0)  # of the uncertainties that a receiver states


def move_by_positions(
    store: TrajectoryStore, source: PositionSource, loops: Sequence[Loop]
) -> list[PositionUse]:
    """Move each world that was aligned with positions, whose first keyframe stays.

    The alignments of the source become those of the moved path.

    Args:
        store: the path, in metres.
        source: of the positions, after `measure`.
        loops: that the path agrees with.
    """
    uses, alignments = [], []
    for alignment in source.alignments:
        use, moved = None, alignment
        if store.metric.is_metric(alignment.segment):
            use, moved = _move(store, source, alignment, loops)
        alignments.append(moved)
        uses += [] if use is None else [use]
    source.alignments = tuple(alignments)
    return uses


def _move(
    store: TrajectoryStore, source: PositionSource, alignment: PathAlignment, loops: Sequence[Loop]
) -> tuple[PositionUse | None, PathAlignment]:
    world = alignment.segment
    ids, world_from_cam, scale, _ = store.registered(world)
    enu_from_world = np.eye(4)
    enu_from_world[:3, :3], enu_from_world[:3, 3] = alignment.rotation, alignment.translation
    poses = enu_from_world @ world_from_cam
    fixes = _fixes(store, source, alignment, ids, poses)
    is_metric = world not in store.metric.scales and world not in store.metric.worlds_by_sensor
    factors = _loop_factors(loops, ids, scale)
    smallest_m = _ROUNDED * alignment.positions.resolution_m
    found = fuse_positions(poses, fixes, factors, is_metric=is_metric, smallest_m=smallest_m)
    if found is None:
        return None, alignment
    use = _use(source, alignment, fixes, found, poses)
    if not found.is_moved:
        return use, alignment
    placed = sim3.rigid_part(found.poses)
    world_from_enu = world_from_cam[0] @ inverse(placed[0])
    moved = world_from_enu @ placed
    moved[0] = world_from_cam[0]
    factor = sim3.scale_of(found.poses)
    worlds = np.full(len(ids), world, np.int64)
    store.move_keyframes(ids, worlds, moved, scale * factor, found.from_first[:, :6, :6])
    back = inverse(world_from_enu)
    return use, replace(alignment, rotation=back[:3, :3], translation=back[:3, 3])


def _fixes(
    store: TrajectoryStore,
    source: PositionSource,
    alignment: PathAlignment,
    ids: Ints,
    poses: Floats,
) -> Fixes:
    """Positions at times of the path, each in the frame of the keyframe that its frame follows."""
    path, given = store.path(), alignment.positions
    rows = np.flatnonzero(path.world == alignment.segment)
    stamps_ns = path.trajectory.stamps_ns[rows]
    arms = path.trajectory.world_from_cam[rows, :3, :3] @ source.lever_arm_m
    xyz = alignment.transform(path.trajectory.positions[rows] + arms)
    before, fraction, chosen = associate(stamps_ns, given.stamps_ns)
    way = xyz[before + 1] - xyz[before]
    elapsed = 1e-9 * (stamps_ns[before + 1] - stamps_ns[before])
    points = xyz[before] + fraction[:, None] * way
    at = np.searchsorted(ids, store.frames["keyframe"][rows][before])
    off = points - poses[at, :3, 3]
    in_cam = np.einsum("mji,mj->mi", poses[at, :3, :3], off)
    sigma = given.sigma_m[chosen]
    is_stated = len(sigma) > 0 and np.isfinite(sigma).all() and (sigma > 0.0).all()
    relative = sigma / np.median(sigma) if is_stated else np.ones(len(chosen))
    times_s = 1e-9 * (given.stamps_ns[chosen] - stamps_ns[0])
    xyz = given.xyz[chosen]
    # Receivers repeat the last position where they are slow, or have none.
    moves = np.linalg.norm(np.diff(points, axis=0), axis=1) > max(_HELD_M, 2.0 * given.resolution_m)
    is_new = np.r_[True, ~(moves & (np.diff(xyz, axis=0) == 0.0).all(axis=1))][: len(xyz)]
    fixes = Fixes(
        *(times_s, at, in_cam, way / elapsed[:, None], xyz), np.clip(relative, *_USUAL_RATIO)
    )
    return fixes.rows(is_new)


def _loop_factors(loops: Sequence[Loop], ids: Ints, scale: Floats) -> LoopFactors:
    """Some of the loops between keyframes (by their ids) of one world."""
    row = {int(number): n for n, number in enumerate(ids)}
    inside = [
        (row[loop.earlier.keyframe], row[loop.later.keyframe], loop.covariance)
        for loop in loops
        if loop.earlier.session == loop.later.session
        and loop.earlier.keyframe in row
        and loop.later.keyframe in row
    ]
    chosen = np.unique(np.linspace(0, len(inside) - 1, min(len(inside), _MAX_LOOPS)).astype(int))
    a, b = (np.array([inside[n][end] for n in chosen], np.int64) for end in (0, 1))
    covariance = np.zeros((len(chosen), 7, 7))
    for n, each in enumerate(chosen):
        unit = np.r_[np.ones(3), np.full(3, scale[b[n]]), 1.0]
        covariance[n] = unit[:, None] * inside[each][2] * unit
        covariance[n, 6, 6] = max(covariance[n, 6, 6], _LOG_SCALE**2)
    return LoopFactors(a, b, covariance)


def _use(
    source: PositionSource,
    alignment: PathAlignment,
    fixes: Fixes,
    found: FusedPath,
    poses: Floats,
) -> PositionUse:
    use = PositionUse(
        alignment.segment,
        source.positions.source,
        int(found.used.sum()),
        int((~found.used).sum()),
        found.jumps,
        alignment.offset_s,
        *found.noise[:3],
        0.0,
    )
    if not found.is_moved:
        return use
    off = np.linalg.norm(found.poses[:, :3, 3] - poses[:, :3, 3], axis=1)
    variances = np.median(np.diagonal(found.in_frame, axis1=1, axis2=2), axis=0)
    return use._replace(
        moved_m=float(np.sqrt((off**2).mean())),
        sigma_m=float(np.sqrt(variances[3:6].mean())),
        sigma_deg=float(np.degrees(np.sqrt(variances[:3].mean()))),
    )
