"""Local mapping: new keyframes and landmarks, and removal of bad landmarks."""

from __future__ import annotations

import numpy as np

from vo.base.config import MappingConfig
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Bools, Floats, Ints
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.neighbours import far_from
from vo.engine.geometry.surfaces import surface_normals
from vo.engine.mapping.keyframe import FrameId, Keyframe, NewObservations, without_disparity
from vo.engine.mapping.keyframe_triangulation import (
    KeyframeTriangulator,
    StereoFeatures,
    StereoTriangulator,
)
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.octaves import predicted_octave
from vo.engine.mapping.patch_search import find_patches
from vo.engine.mapping.tracked_frame import TrackedFrame

# A landmark's patch is replaced where its size has changed by more than this ratio, or its
# correlation is lower than this.
_MAX_PATCH_SCALE = 1.3
_MIN_PATCH_SCORE = 0.9
_FEW_LANDMARKS = 100  # of a keyframe of a pair, from which the motion must give further ones
_MIN_OBSERVATIONS = 2  # keyframes that must observe a landmark, unless it is new and has a depth


class LocalMapper:
    """Adds keyframes and landmarks to the local map and removes bad landmarks.

    Attributes:
        stopwatch: measures the stage `map`.
    """

    def __init__(
        self,
        local_map: LocalMap,
        frontend: Frontend,
        config: MappingConfig,
        stopwatch: Stopwatch,
    ) -> None:
        self.stopwatch = stopwatch
        self._map = local_map
        self._patches = frontend.patches
        self._scale_factor = frontend.scale_factor
        self._config = config
        self._stereo_triangulator = StereoTriangulator(local_map, frontend, config.new_per_keyframe)
        self._keyframe_triangulator = KeyframeTriangulator(local_map, frontend, config)

    def stereo_features(self, frame: PreprocessedFrame) -> StereoFeatures:
        """Features of a frame that have a disparity."""
        every = np.ones(len(frame.keypoints), dtype=bool)
        return self._stereo_triangulator.measure(frame, every)

    def add_stereo_landmarks(self, keyframe: Keyframe, features: StereoFeatures) -> None:
        """Add the landmarks of features of a keyframe that have a disparity."""
        self._stereo_triangulator.add_landmarks(keyframe, features)

    def add_first_keyframe(
        self, frame: PreprocessedFrame, world_from_cam: Floats, segment: int, free: Bools
    ) -> Keyframe:
        """Add the keyframe that later poses of a segment are relative to."""
        keyframe = self.add_keyframe_at(frame, world_from_cam, segment, free)
        keyframe.covariance = np.zeros((6, 6))
        return keyframe

    def add_keyframe_at(
        self, frame: PreprocessedFrame, world_from_cam: Floats, segment: int, free: Bools
    ) -> Keyframe:
        """Add a keyframe without observations; `free` (N,) marks features without a landmark."""
        number = FrameId(frame.index, frame.stamp_ns, segment)
        keyframe = self._map.add_keyframe(
            number, frame.image0, world_from_cam, frame.keypoints, free
        )
        keyframe.mask = frame.masks[0]
        return keyframe

    @timed("map")
    def add_keyframe(
        self, frame: PreprocessedFrame, tracked: TrackedFrame, segment: int
    ) -> Keyframe:
        """Add a tracked frame with its observations."""
        observed = tracked.observed
        free = far_from(frame.keypoints.xy, observed.image_xy)
        keyframe = self.add_keyframe_at(frame, tracked.world_from_cam, segment, free)
        is_alone = frame.right is not None and tracked.lacks_disparities
        keyframe.is_doubted = is_alone or tracked.is_hardly_confirmed or tracked.is_contradicted
        rows = self._map.rows(tracked.ids)
        kept = np.flatnonzero(tracked.inlier & (rows >= 0))
        rows = rows[kept]
        keyframe.add_observations(
            NewObservations(
                tracked.ids[kept],
                observed.xy[kept],
                observed.image_xy[kept],
                observed.disparity[kept],
                observed.sigma_px[kept],
            )
        )
        if tracked.velocity is not None:
            keyframe.velocity = tracked.velocity
            keyframe.undistort(self._map.rig, self._map.inverse_depth(keyframe))
        self._map.last_seen[rows] = keyframe.id
        self._replace_patches(keyframe, rows, observed.scale[kept], observed.score[kept])
        return keyframe

    @timed("map")
    def extend(self, keyframe: Keyframe, frame: PreprocessedFrame) -> None:
        """Add landmarks for the newest keyframe's features without one."""
        if frame.has_disparity:
            features = self._stereo_triangulator.measure(frame, keyframe.free)
            self._stereo_triangulator.add_landmarks(keyframe, features)
        if not frame.has_disparity or len(keyframe.landmark) < _FEW_LANDMARKS:
            self._keyframe_triangulator.add_landmarks(keyframe, frame.image0)
        self.estimate_normals(keyframe, only_new=True)
        self._observe_in_earlier(keyframe)

    def estimate_normals(self, keyframe: Keyframe, *, only_new: bool = False) -> None:
        """Estimate the surface normals of a keyframe's landmarks from neighbouring landmarks."""
        rows = self._map.rows(keyframe.landmark)
        observed = np.flatnonzero(rows >= 0)
        rows = rows[observed]
        in_cam = transform_points(inverse(keyframe.world_from_cam), self._map.xyz[rows])
        ahead = in_cam[:, 2] > 0
        rows, observed, depth = rows[ahead], observed[ahead], in_cam[ahead, 2]
        of = np.flatnonzero(self._map.found[rows] <= 1) if only_new else np.arange(len(rows))
        self._map.normal[rows[of]] = surface_normals(
            keyframe.xy[observed], depth, of, keyframe.world_from_cam, self._map.rig.intrinsics
        )

    def cull(self) -> None:
        """Remove landmarks that are seldom found, or observed by too few keyframes."""
        local_map = self._map
        newest = local_map.keyframes[-1].id
        _, row = local_map.observation_rows()
        disparity = np.concatenate([k.disparity for k in local_map.keyframes])
        count = np.bincount(row, minlength=len(local_map))
        has_depth = np.zeros(len(local_map), dtype=bool)
        has_depth[row[~np.isnan(disparity)]] = True
        rarely = local_map.found < self._config.min_found_ratio * local_map.visible
        is_new = local_map.last_seen >= newest - 1
        weak = (count < _MIN_OBSERVATIONS) & ~(has_depth & is_new)
        local_map.keep_landmarks((count > 0) & ~rarely & ~weak)

    def _replace_patches(
        self, keyframe: Keyframe, rows: Ints, scale: Floats, score: Floats
    ) -> None:
        """Take patches from this keyframe where they differ too much from the old ones."""
        local_map = self._map
        is_changed = np.abs(np.log(scale)) > np.log(_MAX_PATCH_SCALE)
        changed = np.flatnonzero(is_changed | (score < _MIN_PATCH_SCORE))
        rows, scale = rows[changed], scale[changed]
        octave = predicted_octave(local_map.octave[rows], scale, self._scale_factor)
        local_map.octave[rows] = octave
        local_map.set_reference(keyframe, changed, rows)

    def _observe_in_earlier(self, keyframe: Keyframe) -> None:
        """Find the newest landmarks in earlier keyframes, which do not observe them yet."""
        local_map = self._map
        new = np.flatnonzero((local_map.last_seen == keyframe.id) & (local_map.found <= 1))
        others = local_map.keyframes[-1 - self._config.fuse_keyframes : -1]
        if len(new) == 0 or not others:
            return
        first = local_map.id[new[0]]
        unseen = [~_among(local_map.id[new] - first, k.landmark - first) for k in others]
        rows = np.concatenate([new[mask] for mask in unseen])
        begin = len(local_map.keyframes) - 1 - len(others)
        camera = np.arange(begin, begin + len(others)).repeat([mask.sum() for mask in unseen])
        found = find_patches(local_map, rows, camera, self._patches)
        for number, other in enumerate(others, begin):
            here = (found.camera == number).nonzero()[0]
            if len(here):
                ids = local_map.id[found.rows[here]]
                other.add_observations(
                    without_disparity(
                        ids, found.xy[here], found.image_xy[here], self._patches.sigma_px
                    )
                )


def _among(ids: Ints, others: Ints) -> Bools:
    """Mask (n,) of increasing ids, from 0, that are among others (m,); `np.isin` takes longer."""
    there = np.zeros(ids[-1] + 1, dtype=bool)
    there[others[(others >= 0) & (others <= ids[-1])]] = True
    return np.asarray(there[ids])
