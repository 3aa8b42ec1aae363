"""Keyframes of a run moved by positions and wheels, once, after its last frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.records.metric_scale import PositionUse, WheelUse
from vo.base.types import Floats, Ints
from vo.engine.geometry import sim3
from vo.engine.places.records import Loop
from vo.engine.trajectory.store import TrajectoryStore
from vo.runs.scaling.path_factors import Fixes, Given, LoopFactors
from vo.runs.scaling.path_fusion import FusedPath, fuse_path
from vo.runs.scaling.position_source import PathAlignment, PositionSource
from vo.runs.scaling.timed_fit import associate
from vo.runs.scaling.wheel_joins import Join, join_pieces
from vo.runs.scaling.wheel_source import WheelSource

_MAX_LOOPS = 16
_LOG_SCALE = 1e-4  # standard deviation that the scale of a loop has at least
_ROUNDED = 12.0**-0.5
_HELD_M = 0.1  # way of the camera between two positions that are equal to the last digit
_USUAL_RATIO = (0.2, 5.0)  # of the uncertainties that a receiver states


class MovedPath(NamedTuple):
    """What became of positions and of wheel odometry, by world, and notes for the user."""

    positions: tuple[PositionUse, ...]
    wheel: tuple[WheelUse, ...]
    notes: tuple[str, ...]


def move_path(
    store: TrajectoryStore,
    source: PositionSource | None,
    wheel: WheelSource | None,
    loops: Sequence[Loop],
) -> MovedPath:
    """Move each world that was aligned with positions or wheels; its first keyframe stays.

    Worlds that the wheels join become one before. The alignments of the positions become those of
    the moved path.

    Args:
        store: the path, in metres.
        source: of the positions, after `measure`; None for no positions.
        wheel: after `measure`; None for no wheel odometry.
        loops: that the path agrees with.
    """
    aligned = {} if source is None else {each.segment: each for each in source.alignments}
    positions: list[PositionUse] = []
    moved_m: dict[int, float] = {}
    joins = [] if wheel is None else join_pieces(store, wheel, aligned)
    for world in sorted({*aligned, *({} if wheel is None else wheel.fits)}):
        if not store.metric.is_metric(world) or store.world(world) != world:
            continue
        alignment = aligned.get(world)
        keyframes = _Keyframes.of(store, world)
        given = keyframes.given(store, wheel, loops, alignment)
        given = given._replace(joined=keyframes.across(joins))
        if alignment is not None and source is not None:
            use, aligned[world] = _move_in_frame(store, source, alignment, keyframes, given)
            positions += [] if use is None else [use]
            moved_m[world] = 0.0 if use is None else use.moved_m
        elif given.ways is not None:
            moved_m[world] = _move_by_wheel(store, keyframes, given)
    if source is not None:
        source.alignments = tuple(aligned[number] for number in sorted(aligned))
    uses = () if wheel is None else wheel.uses(store.metric, moved_m)
    return MovedPath(tuple(positions), uses, tuple(join.note for join in joins))


class _Keyframes(NamedTuple):
    """All keyframes of a world: see `TrajectoryStore.registered`."""

    world: int
    ids: Ints
    world_from_cam: Floats
    scale: Floats

    @classmethod
    def of(cls, store: TrajectoryStore, world: int) -> _Keyframes:
        return cls(world, *store.registered(world)[:3])

    def given(
        self,
        store: TrajectoryStore,
        wheel: WheelSource | None,
        loops: Sequence[Loop],
        alignment: PathAlignment | None,
    ) -> Given:
        """What is known of them besides positions."""
        scale = store.metric.scales.get(self.world)
        is_metric = scale is None and self.world not in store.metric.worlds_by_sensor
        smallest_m = 0.0 if alignment is None else _ROUNDED * alignment.positions.resolution_m
        given = Given(_loop_factors(loops, self.ids, self.scale), is_metric, smallest_m)
        is_known = is_metric or (scale is None and alignment is None)
        if is_known or wheel is None or self.world not in wheel.fits:
            return given  # two cameras, or an inertial sensor, measure lengths better than wheels
        rows = store.keyframes_by_id(self.ids.tolist())
        stamps_ns, segments = np.array([(each.stamp_ns, each.segment) for each in rows]).T
        ways = wheel.factors(self.world, self.world_from_cam, stamps_ns, segments)
        is_free = scale is None or alignment is not None or scale.source == wheel.name
        return given._replace(
            ways=ways, scale_sigma=None if is_free or scale is None else scale.relative_sigma
        )

    def across(self, joins: Sequence[Join]) -> Floats | None:
        """(n, 7) standard deviations of steps that wheels alone have measured, 0 of others."""
        inside = [join for join in joins if join.keyframe in self.ids]
        if not inside:
            return None
        sigma = np.zeros((len(self.ids), 7))
        sigma[np.searchsorted(self.ids, [join.keyframe for join in inside])] = [
            join.sigma for join in inside
        ]
        return sigma


def _move_in_frame(
    store: TrajectoryStore,
    source: PositionSource,
    alignment: PathAlignment,
    keyframes: _Keyframes,
    given: Given,
) -> tuple[PositionUse | None, PathAlignment]:
    """Move a world among its positions; what became of them, and where it is."""
    enu_from_world = np.eye(4)
    enu_from_world[:3, :3], enu_from_world[:3, 3] = alignment.rotation, alignment.translation
    poses = enu_from_world @ keyframes.world_from_cam
    fixes = _fixes(store, source, alignment, keyframes.ids, poses)
    found = fuse_path(poses, fixes, given)
    if found is None:
        return None, alignment
    use = _use(source, alignment, fixes, found, poses)
    if not found.is_moved:
        return use, alignment
    back = inverse(_move(store, keyframes, found))
    return use, replace(alignment, rotation=back[:3, :3], translation=back[:3, 3])


def _move_by_wheel(store: TrajectoryStore, keyframes: _Keyframes, given: Given) -> float:
    """Move a world by the ways of wheels alone; root mean square distance."""
    nothing = Fixes(*(np.empty((0, *size)) for size in ((), (), (3,), (3,), (3,), ())))
    poses = keyframes.world_from_cam
    found = fuse_path(poses, replace(nothing, at=np.empty(0, np.int64)), given)
    if found is None or not found.is_moved:
        return 0.0
    world_from_new = _move(store, keyframes, found)
    moved = world_from_new @ sim3.rigid_part(found.poses)
    off = np.linalg.norm((moved - poses)[:, :3, 3], axis=1)
    return float(np.sqrt((off**2).mean()))


def _move(store: TrajectoryStore, keyframes: _Keyframes, found: FusedPath) -> Floats:
    """Move keyframes in the store; (4, 4) of the frame of the fused path in the world."""
    world, ids, world_from_cam, scale = keyframes
    fused = sim3.rigid_part(found.poses)
    world_from_fused = world_from_cam[0] @ inverse(fused[0])
    moved = world_from_fused @ fused
    moved[0] = world_from_cam[0]
    factor = sim3.scale_of(found.poses)
    worlds = np.full(len(ids), world, np.int64)
    store.move_keyframes(ids, worlds, moved, scale * factor, found.from_first[:, :6, :6])
    return np.asarray(world_from_fused)


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
