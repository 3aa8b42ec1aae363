"""Where keyframes of a single camera are by an inertial sensor, and by the pose graph after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.similarity import Similarity
from vo.base.types import Floats, Trajectory
from vo.engine.inertial.world_alignment import alignment_covariance, upright_alignment
from vo.engine.places.records import InertialPose, RegisteredKeyframes
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.trajectory.map_frame import scaled_covariance


@frozen(eq=False)
class EstimatedPose:
    """A keyframe of a single camera with its newest inertial pose."""

    frame_index: int  # number of its frame
    segment: int  # number of its segment
    world: int  # number of its world by the inertial sensor
    origin: int  # id of the first keyframe of that world; another one is another frame
    pose: Floats  # (4, 4) upright_from_cam0
    scale: float  # metres of one unit of its segment
    covariance: Floats  # (6, 6) of the pose


class _Correction(NamedTuple):
    """How the pose graph has moved a world."""

    newest: int  # id of the newest keyframe that it has placed
    origin: int  # id of the first keyframe of the world
    map_from_upright: Similarity  # from the frame of the inertial poses


class InertialMapPoses:
    """Places keyframes of a single camera in a metric world whose z axis points up.

    A metric path is left where it is. Where loops are closed, the pose graph starts from the
    inertial poses, and its result is brought back to metres and the vertical. Keyframes that are
    newer than those of the graph follow by their inertial motion since then.

    Attributes:
        awaits_graph: whether keyframes that the pose graph has placed got metric poses since.
    """

    def __init__(self, trajectory: TrajectoryBuilder, cam0_from_rectified: Floats) -> None:
        self.awaits_graph = False
        self._trajectory = trajectory
        self._cam0_from_rectified = cam0_from_rectified
        self._poses: dict[int, EstimatedPose] = {}  # newest ones, by id of the keyframe
        self._given: Mapping[int, EstimatedPose] = {}  # those of the newest pose graph
        self._sigma = (0.0, 0.0)  # of their scale (relative) and vertical (radians)
        self._in_graph: set[int] = set()  # segments whose keyframes the pose graph has placed
        self._corrections: dict[int, _Correction] = {}  # by the pose graph, by number of the world

    @property
    def has_poses(self) -> bool:
        """Whether any keyframe has an inertial pose."""
        return bool(self._poses)

    @property
    def metric_worlds(self) -> set[int]:
        """Numbers of the worlds whose lengths are metres now."""
        return self._trajectory.store.metric.worlds_by_sensor

    def is_in_graph(self, segment: int) -> bool:
        """Whether the pose graph has placed keyframes of a segment."""
        return segment in self._in_graph

    def map_from_upright(self, world: int) -> Floats:
        """(3, 3) from the frame of the newest inertial poses of a world to that of the path.

        They are one, but for what the pose graph has changed.
        """
        correction = self._corrections.get(world)
        return np.eye(3) if correction is None else correction.map_from_upright.rotation

    def update(
        self, world: int, estimated: Mapping[int, EstimatedPose], *, keeps_earlier: bool
    ) -> None:
        """Place keyframes of a world by their newest inertial poses.

        Args:
            world: its number by the inertial sensor.
            estimated: by id of the keyframe.
            keeps_earlier: whether keyframes before them stay, else they follow the first one.
        """
        self._poses.update(estimated)
        origins = {e.origin for e in estimated.values()}
        correction = self._corrections.get(world)
        if correction is not None and {correction.origin} == origins:
            self._put([k for k in estimated if k > correction.newest], correction)
        elif any(e.segment in self._in_graph for e in estimated.values()):
            self.awaits_graph = True
        else:
            self._put(list(estimated), None, keeps_earlier=keeps_earlier)

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on; inertial poses are found anew."""
        self._poses = {k: e for k, e in self._poses.items() if e.frame_index < frame_index}
        self._corrections.clear()

    def begin_frame_of(self, world: int) -> None:
        """Further inertial poses of a world are in another frame, which no pose graph knows."""
        self._corrections.pop(world, None)

    def give(
        self, world: int | None, together: Mapping[int, EstimatedPose], sigma: tuple[float, float]
    ) -> Mapping[int, InertialPose]:
        """Poses by id of the keyframe for the pose graph that is optimised next.

        Those of one segment are in one frame. `together` are those of the newest world, `sigma` of
        their scale (relative) and vertical (radians).
        """
        self.awaits_graph = False
        given = {k: e for k, e in self._poses.items() if e.world != world} | dict(together)
        origin = {e.segment: e.origin for _, e in sorted(given.items())}  # the newest ones
        self._given = {k: e for k, e in given.items() if e.origin == origin[e.segment]}
        self._sigma = sigma
        to_rectified = self._trajectory.world_from_rectified
        return {
            k: InertialPose(e.world, to_rectified(e.pose), e.scale) for k, e in self._given.items()
        }

    def to_metres(self, registered: RegisteredKeyframes, session: int) -> RegisteredKeyframes:
        """Keyframes as the pose graph has placed them, in metric worlds whose z axis points up.

        A world of a loaded map stays as it is, and so does one without inertial poses.
        """
        own = np.array([key.session == session for key in registered.keys])
        known = np.array(
            [k.session == session and k.keyframe in self._given for k in registered.keys]
        )
        if not known.any():
            return registered
        pose = self._trajectory.world_from_cam0(registered.world_from_cam)
        scale, covariance = registered.scale.copy(), registered.covariance.copy()
        for world in np.unique(registered.world[known]).tolist():
            rows = registered.world == world
            if not own[rows].all():
                continue
            chosen = np.flatnonzero(rows & known)
            estimated = [self._given[registered.keys[n].keyframe] for n in chosen.tolist()]
            found = upright_alignment(
                pose[chosen],
                scale[chosen],
                np.stack([e.pose for e in estimated]),
                np.array([e.scale for e in estimated]),
            )
            pose[rows] = found.transform_poses(pose[rows])
            scale[rows] *= found.scale
            from_rectified = pose[rows] @ self._cam0_from_rectified
            added = alignment_covariance(from_rectified, *self._sigma)
            covariance[rows] = scaled_covariance(covariance[rows], found.scale) + added
        rectified = self._trajectory.world_from_rectified(pose)
        return replace(registered, world_from_cam=rectified, scale=scale, covariance=covariance)

    def move_keyframes(self, registered: RegisteredKeyframes, session: int) -> None:
        """Place keyframes of a session by a result of the pose graph, and newer ones after them."""
        registered = self.to_metres(registered, session)
        self._trajectory.move_keyframes(registered, session)
        rows = [n for n, key in enumerate(registered.keys) if key.session == session]
        ids = sorted(registered.keys[n].keyframe for n in rows)
        segments = {pose.segment for pose in self._trajectory.store.keyframes_by_id(ids)}
        self._in_graph |= segments
        world_of = self._trajectory.store.world
        loaded = {
            world
            for key, world in zip(registered.keys, registered.world.tolist(), strict=True)
            if key.session != session
        }
        known = {world_of(self._given[k].segment) for k in ids if k in self._given}
        metric = {segment for segment in segments if world_of(segment) in known - loaded}
        by_sensor = self._trajectory.store.metric.by_sensor
        by_sensor -= segments - metric
        by_sensor |= metric
        scale = {registered.keys[n].keyframe: float(registered.scale[n]) for n in rows}
        newest = {self._poses[k].world: k for k in ids if k in self._poses}
        for world, keyframe in newest.items():
            self._corrections[world] = self._correction(keyframe, scale[keyframe])
            later = [k for k, e in self._poses.items() if k > keyframe and e.world == world]
            self._put(later, self._corrections[world])

    def path_before_loops(self) -> Trajectory:
        """The path by the inertial poses alone, as it would be without loops."""
        keyframes = sorted(self._poses)
        estimated = [self._poses[k] for k in keyframes]
        return self._trajectory.store.trajectory_with(
            np.array(keyframes, np.int64),
            np.array([e.world for e in estimated], np.int64),
            np.array([e.pose for e in estimated]).reshape(-1, 4, 4),
            np.array([e.scale for e in estimated]),
        )

    def _correction(self, keyframe: int, scale: float) -> _Correction:
        """The correction of a world by its newest keyframe that the pose graph has placed."""
        (registered,) = self._trajectory.store.keyframes_by_id([keyframe])
        estimated = self._poses[keyframe]
        factor = scale / estimated.scale
        turn = registered.world_from_cam0[:3, :3] @ estimated.pose[:3, :3].T
        shift = registered.world_from_cam0[:3, 3] - factor * turn @ estimated.pose[:3, 3]
        return _Correction(keyframe, estimated.origin, Similarity(factor, turn, shift))

    def _put(
        self, keyframes: list[int], correction: _Correction | None, *, keeps_earlier: bool = True
    ) -> None:
        """Give keyframes their inertial poses, as the pose graph has moved their world."""
        if not keyframes:
            return
        estimated = [self._poses[k] for k in keyframes]
        store = self._trajectory.store
        pose = np.stack([e.pose for e in estimated])
        scale = np.array([e.scale for e in estimated])
        covariance = np.stack([e.covariance for e in estimated])
        world = np.array([e.world for e in estimated], np.int64)
        if correction is None:
            store.metric.by_sensor |= {e.segment for e in estimated}
        else:
            (registered,) = store.keyframes_by_id([correction.newest])
            world[:] = store.world(registered.segment)
            if registered.segment in store.metric.by_sensor:
                store.metric.by_sensor |= {e.segment for e in estimated}
            moved = correction.map_from_upright
            pose, scale = moved.transform_poses(pose), scale * moved.scale
            covariance = scaled_covariance(covariance, moved.scale)
        store.move_keyframes(
            np.array(keyframes, np.int64),
            world,
            pose,
            scale,
            covariance,
            keeps_earlier=keeps_earlier,
        )
