"""Adjustment of whole paths at the end of a run, by landmarks searched anew in all keyframes.

Each round searches every landmark in every keyframe, with the poses of the round before, and
optimises all poses and landmarks (docs/experiments/best.md). Paths that are not connected by
landmarks stay as they are, as do those of cameras with a rolling shutter.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.config import Config
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.similarity import Similarity
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Bytes, Floats, Ints
from vo.engine.backend.loop_adjustment import (
    AdjustedPath,
    adjust_path,
    calibration_step,
    path_covariance,
    path_information,
)
from vo.engine.backend.residuals import residuals, with_measured_noise
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.mapping.local_map import LocalMap
from vo.engine.memory.final_frames import AdjustedViews, FinalFrames
from vo.engine.memory.loop_bundle import loops_inside, measured_motions, with_scale_kept
from vo.engine.memory.rematching import PathViews, references, rematched, with_depths
from vo.engine.places.records import Loop, RegisteredKeyframes
from vo.engine.trajectory.builder import TrajectoryBuilder

if TYPE_CHECKING:  # many runs have no sensor
    from vo.engine.backend.path_equations import PathEquations
    from vo.engine.inertial.joint_path import JointPaths

_log = logging.getLogger(__name__)
_MAX_KEYFRAMES = 2000  # whose images stay in memory
_MIN_KEYFRAMES = 3
_MAX_JOINT = 400  # with a sensor, whose equations are dense
_SESSION = 0  # there is no adjustment in a loaded map
# Landmarks that a keyframe shares with those before it; where there are fewer, a sensor is better.
_MIN_SHARED, _MIN_SHARED_BY_SENSOR = 20, 60
_MIN_DECREASE = 1e-6  # of the cost: with 1e-4 steps end before a drift of the scale is gone
# Residuals in standard deviations above which observations are dropped, after a round and after
# the last one.
_GATE, _LAST_GATE = 4.0, 0.6
# Error of disparities from which further ones would change the scale of the path: real
# pairs have 0.09 px and more at the sides, rendered ones at most 0.03.
_MAX_DISPARITY_ERROR_PX = 0.05


class _Stored(NamedTuple):
    """A keyframe; rows of landmarks and observations belong together.

    Attributes:
        xyz: (n, 3) landmarks in the frame of the keyframe.
        normal: (n, 3) of their surfaces, likewise.
    """

    keyframe: Keyframe
    image: Bytes
    landmark: Ints
    xyz: Floats
    normal: Floats
    image_xy: Floats
    disparity: Floats
    sigma_px: Floats


class FinalAdjustment:
    """Keeps all keyframes with their images, and adjusts paths at the end; a `KeyframeStore`.

    Attributes:
        frames: between the keyframes.
    """

    def __init__(
        self,
        trajectory: TrajectoryBuilder,
        frontend: Frontend,
        config: Config,
        stopwatch: Stopwatch,
    ) -> None:
        self.stopwatch = stopwatch
        self.frames = FinalFrames(trajectory, frontend.patches, _LAST_GATE)
        self._trajectory = trajectory
        self._config, self._rounds = config, config.refinement.rounds
        self._patches, self._stereo = frontend.patches, frontend.stereo
        self._stored: dict[int, _Stored] | None = {}
        self._pairs: dict[int, PreprocessedFrame] = {}
        self._joint: JointPaths | None = None
        self._is_finished = False

    def see(self, keyframe: Keyframe, frame: PreprocessedFrame) -> None:
        """Keep the images of a new keyframe, where they are a pair."""
        if self._stored is not None and frame.right is not None:
            kept = replace(frame, pyramid=(), misled=(), second_features=())
            self._pairs[keyframe.id] = kept

    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        """Keep a keyframe, its image and what it observes."""
        if self._is_finished or self._stored is None:
            return
        if len(self._stored) == _MAX_KEYFRAMES:
            _log.warning(
                "there are more than %d keyframes, too many for the adjustment of the whole path "
                "at the end, which is left out",
                _MAX_KEYFRAMES,
            )
            self._stored, self._pairs = None, {}
            return
        known = landmarks()
        order = np.argsort(keyframe.landmark)
        order = order[np.isin(keyframe.landmark[order], known.id, assume_unique=True)]
        cam_from_world = inverse(keyframe.world_from_cam)
        pair = self._pairs.get(keyframe.id)
        self._stored[keyframe.id] = _Stored(
            keyframe,
            image.copy() if pair is None else pair.image0,
            known.id,
            transform_points(cam_from_world, known.xyz),
            known.normal @ cam_from_world[:3, :3].T,
            keyframe.image_xy[order],
            keyframe.disparity[order],
            keyframe.sigma_px[order],
        )

    def forget_from(self, frame_index: int) -> None:
        """Forget keyframes of a frame and those after it, which are tracked anew."""
        self.frames.forget_from(frame_index)
        if self._stored is not None:
            kept = {k: s for k, s in self._stored.items() if s.keyframe.frame.index < frame_index}
            self._stored = kept
            self._pairs = {k: p for k, p in self._pairs.items() if p.index < frame_index}

    @timed("adjustment")
    def finish(
        self,
        local_map: LocalMap,
        loops: Sequence[Loop],
        unsure: set[int],
        joint: JointPaths | None = None,
    ) -> list[RegisteredKeyframes]:
        """Adjust the paths of all worlds but the unsure ones; those that were moved.

        `joint`: of an inertial sensor, whose samples two cameras' paths follow, too.
        """
        local_map.hand_over([self])
        self._joint = joint
        self._is_finished = True
        stored, self._stored = self._stored or {}, {}
        moved = []
        world_of = self._trajectory.store.world
        segments = {each.keyframe.frame.segment for each in stored.values()}
        for world in sorted({world_of(segment) for segment in segments} - unsure):
            registered = self._trajectory.registered(world, _SESSION)
            keys = [key.keyframe for key in registered.keys]
            if len(keys) < _MIN_KEYFRAMES or any(key not in stored for key in keys):
                continue
            if any(stored[key].keyframe.velocity is not None for key in keys):
                continue
            adjusted = self._adjusted(registered, [stored[key] for key in keys], local_map, loops)
            if adjusted is not None:
                self._trajectory.move_keyframes(adjusted[0], _SESSION)
                self.frames.fit(adjusted[1])
                moved.append(adjusted[0])
        self._pairs = {}
        return moved

    def _adjusted(
        self,
        registered: RegisteredKeyframes,
        stored: Sequence[_Stored],
        local_map: LocalMap,
        loops: Sequence[Loop],
    ) -> tuple[RegisteredKeyframes, AdjustedViews] | None:
        """The keyframes of a world after the last round that connects them; None without one."""
        rig, rounds, smoothing = local_map.rig, self._rounds, self._config.smoothing
        by_sensor = int(registered.world[0]) in self._trajectory.store.metric.worlds_with_sensor
        connected: PathViews | None = None
        has_lens_error = rig.k1_error != 0.0 and not rig.is_metric
        inside = loops_inside(registered.keys, loops)
        motions = measured_motions(inside, registered.scale)
        pairs = [self._pairs.get(each.keyframe.id) for each in stored]
        measured = views = _views(registered, stored)
        takes_depths = any(pairs) and bool(np.isfinite(measured.disparity).any())
        for number in range(rounds + 1):
            if number < rounds:
                searched = references(views)
                views = rematched(views, measured, rig, self._patches)
                if number > 0 and takes_depths:
                    views = with_depths(views, pairs, rig, self._stereo)
            if not _is_connected(views, _MIN_SHARED_BY_SENSOR if by_sensor else _MIN_SHARED):
                break
            found = adjust_path(self._weighted(views, rig), motions, smoothing, _MIN_DECREASE)
            if found is None:
                return None
            _note_round(number + 1, rounds + 1, views, found)
            views = replace(views, world_from_cam=found.world_from_cam, points=found.points)
            connected, of_landmarks = views, searched
            if number < rounds:
                if has_lens_error or (number == 0 and takes_depths):
                    step = calibration_step(self._weighted(views, rig), smoothing)
                    if has_lens_error:
                        rig = rig.with_k1_error(rig.k1_error + float(step[0]))
                    else:
                        takes_depths = _is_small(step, rig)
                off, *_ = residuals(self._problem(views, rig), views.world_from_cam, views.points)
                gate = _GATE if number < rounds - 1 else _LAST_GATE
                views = views.select(np.flatnonzero(off < gate))
        if connected is None or (by_sensor and connected is not views):
            return None
        frames = [each.keyframe.frame for each in stored]
        views, found = connected, AdjustedPath(connected.world_from_cam, connected.points)
        information = path_information(self._weighted(views, rig), found, motions, smoothing)
        if rig.is_metric:
            placed = self._placed(registered, views.world_from_cam, information)
            return placed, AdjustedViews(views, rig, frames, placed.scale, of_landmarks)
        covariance = path_covariance(information)
        depth = [s * each.xyz[:, 2] for s, each in zip(registered.scale, stored, strict=True)]
        start = self._problem(measured, rig)
        kept = with_scale_kept(registered, start, found, np.concatenate(depth), inside)
        if kept is None:
            return None
        unit = kept.scale * _length(views) / _length(kept)
        if covariance is not None:
            kept = replace(kept, covariance=covariance)
            kept = _as_whole_where(kept, registered) if by_sensor else kept
        return kept, AdjustedViews(views, rig, frames, unit, of_landmarks)

    def _placed(
        self, registered: RegisteredKeyframes, poses: Floats, information: PathEquations | None
    ) -> RegisteredKeyframes:
        """A metric path by the information of its images, and by its sensor, where it has one."""
        covariance = path_covariance(information)
        if covariance is None or information is None:
            return replace(registered, world_from_cam=poses)
        ids, placed = [key.keyframe for key in registered.keys], None
        if self._joint is not None and len(ids) <= _MAX_JOINT:
            placed = self._joint.of(ids, poses, information.dense())
        poses, covariance = placed or (poses, covariance)
        return replace(registered, world_from_cam=poses, covariance=covariance)

    def _weighted(self, views: PathViews, rig: RectifiedRig) -> WindowProblem:
        return with_measured_noise(self._problem(views, rig))

    def _problem(self, views: PathViews, rig: RectifiedRig) -> WindowProblem:
        return views.problem(rig, self._config.stereo.sigma_disparity_px)


def _views(registered: RegisteredKeyframes, stored: Sequence[_Stored]) -> PathViews:
    """What was observed while running; a landmark is where its newest keyframe has it."""
    poses = registered.world_from_cam
    xyz = [
        transform_points(pose, unit * each.xyz)
        for pose, unit, each in zip(poses, registered.scale.tolist(), stored, strict=True)
    ]
    normal = [each.normal @ pose[:3, :3].T for pose, each in zip(poses, stored, strict=True)]
    landmark = np.concatenate([each.landmark for each in stored])
    last, point = np.unique(landmark[::-1], return_index=True, return_inverse=True)[1:]
    return PathViews(
        np.stack([each.image for each in stored]),
        [each.keyframe.mask for each in stored],
        poses,
        np.concatenate(xyz)[::-1][last],
        np.concatenate(normal)[::-1][last],
        np.repeat(np.arange(len(stored)), [len(each.landmark) for each in stored]),
        np.ascontiguousarray(point[::-1]),
        np.concatenate([each.image_xy for each in stored]),
        np.concatenate([each.disparity for each in stored]),
        np.concatenate([each.sigma_px for each in stored]),
    )


def _length(path: PathViews | RegisteredKeyframes) -> float:
    steps = np.diff(path.world_from_cam[:, :3, 3], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def _note_round(number: int, rounds: int, before: PathViews, found: AdjustedPath) -> None:
    change = np.linalg.norm((found.world_from_cam - before.world_from_cam)[:, :3, 3], axis=1)
    _log.info(
        "whole path, adjustment %d of %d: %d observations, moved by %.2g (largest %.2g)",
        *(number, rounds, len(before.point)),
        *(float(np.sqrt(np.mean(change**2))), float(change.max())),
    )


def _as_whole_where(
    adjusted: RegisteredKeyframes, before: RegisteredKeyframes
) -> RegisteredKeyframes:
    """An adjusted path with the mean scale and direction of before, which a sensor measures."""
    poses, old = adjusted.world_from_cam, before.world_from_cam
    u, _, vt = np.linalg.svd(np.einsum("kij,klj->il", old[:, :3, :3], poses[:, :3, :3]))
    unit, turn = float(np.exp(np.log(before.scale / adjusted.scale).mean())), u @ vt
    moved = Similarity(unit, turn, old[0, :3, 3] - unit * turn @ poses[0, :3, 3])
    poses, scale = moved.transform_poses(poses), adjusted.scale * unit
    # Errors of metre and vertical stay.
    return replace(adjusted, world_from_cam=poses, scale=scale, covariance=before.covariance)


def _is_small(bias: Floats, rig: RectifiedRig) -> bool:
    """Whether an error of disparities is, in the middle and at the sides of images."""
    edge = max(rig.cx, rig.width - rig.cx) / rig.fx
    return bool((np.abs(bias) * (1.0, edge**2) < _MAX_DISPARITY_ERROR_PX).all())


def _is_connected(views: PathViews, fewest: int) -> bool:
    """Whether each keyframe shares enough landmarks with those before it."""
    first = np.full(len(views.points), len(views.images))
    np.minimum.at(first, views.point, views.keyframe)
    again = views.keyframe[first[views.point] < views.keyframe]
    shared = np.bincount(again, minlength=len(views.images))[1:]
    return bool((shared >= fewest).all())
