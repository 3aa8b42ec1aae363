"""New landmarks: from disparities of one frame, or from features that two keyframes share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.config import MappingConfig
from vo.base.frozen import frozen
from vo.base.geometry.quantiles import median
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bools, Bytes, Floats, Ints
from vo.engine.frontend.contracts import EpipolarSegments, feature_set
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.patch_alignment import Alignment, Patches, patches_of
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.epipolar import epipolar_segments
from vo.engine.geometry.homographies import homographies
from vo.engine.geometry.neighbours import distances
from vo.engine.geometry.patch_prediction import predict_patches
from vo.engine.geometry.rolling_shutter import at_middle_row, disparity_at_middle_row
from vo.engine.geometry.surfaces import surface_normals
from vo.engine.geometry.triangulation import TriangulatedPoints, triangulate_pixels
from vo.engine.mapping.keyframe import Keyframe, NewObservations, without_disparity
from vo.engine.mapping.local_map import LocalMap


@frozen(eq=False)
class StereoFeatures:
    """Features with a disparity; rows belong together.

    Attributes:
        rows: (n,) rows of the frame's features.
        disparity: (n,) pixels.
    """

    rows: Ints
    disparity: Floats

    def __len__(self) -> int:
        return len(self.rows)


class StereoTriangulator:
    """Triangulates features with a disparity."""

    def __init__(self, local_map: LocalMap, frontend: Frontend, max_new: int) -> None:
        self._map = local_map
        self._stereo = frontend.stereo
        self._sigma_px = frontend.patches.sigma_px
        self._max_new = max_new

    def measure(self, frame: PreprocessedFrame, free: Bools) -> StereoFeatures:
        """Disparities of free features (N,), of the strongest where there are too many."""
        if not frame.has_disparity:
            return StereoFeatures(np.empty(0, np.int64), np.empty(0))
        rows = np.flatnonzero(free)
        disparity = np.full(len(free), np.nan)
        disparity[rows] = self._stereo.disparities(frame, rows, self._map.rig)
        matched = np.flatnonzero(disparity >= self._stereo.min_disparity_px)
        strongest = self._strongest(frame, matched)
        return StereoFeatures(strongest, disparity[strongest])

    def add_landmarks(self, keyframe: Keyframe, features: StereoFeatures) -> None:
        """Add the landmarks of a keyframe's features."""
        rows, disparity = features.rows, features.disparity
        rig = self._map.rig
        image_xy = keyframe.keypoints.xy[rows].astype(np.float64)
        xy, velocity = keyframe.undistorted_xy[rows], keyframe.velocity
        if velocity is not None:
            disparity = disparity_at_middle_row(rig, image_xy, disparity, velocity)
            xy = at_middle_row(rig, image_xy, disparity / (rig.fx * rig.baseline_m), velocity)
        in_cam = rig.back_project(xy, rig.fx * rig.baseline_m / disparity)
        in_world = transform_points(keyframe.world_from_cam, in_cam)
        ids = self._map.add_landmarks(in_world, keyframe, rows, keyframe)
        sigma_px = np.full(len(rows), self._sigma_px)
        keyframe.add_observations(NewObservations(ids, xy, image_xy, disparity, sigma_px))
        keyframe.free[rows] = False

    def _strongest(self, frame: PreprocessedFrame, rows: Ints) -> Ints:
        """The strongest corners of some features (the detector has spread them evenly)."""
        if len(rows) <= self._max_new:
            return rows
        strength = frame.keypoints.response[rows]
        return np.sort(rows[np.argsort(-strength, kind="stable")[: self._max_new]])


_MIN_DEPTH, _MAX_DEPTH = 0.15, 100.0  # range of depths searched, ratios of the median depth
_MIN_DEPTH_RATIO = 0.75  # of a feature's depth after the camera has come nearer, to that before
_MIN_BASELINE_RATIO = 0.005  # of the baseline to the median depth; less gives no depth
_MIN_LANDMARKS = 8  # of a keyframe to know its median depth
# Minimum parallax of a landmark as a ratio of the angle by which its image has moved: calibration
# errors that vary over the image look like parallax when the camera turns. Measured on one real
# turn; recordings with a perfect calibration don't need it (forward-motion-keyframes.md).
_PARALLAX_RATIO = 0.12
_FEW_LANDMARKS = 150  # a keyframe with fewer landmarks accepts those of turns too
# With even fewer this parallax is enough: depths within a quarter of the truth keep tracking alive
# while the camera turns past a blank wall.
_VERY_FEW_LANDMARKS, _MIN_PARALLAX_VERY_FEW_DEG = 100, 0.3
# Rays move by less than this times the pixels of the image, in any usable part of a lens.
_MAX_STRETCH = 2.0
_MAX_CORRECTION_PX = 3.0  # of a match, when its patch is predicted with the surface


class Search(NamedTuple):
    """What is searched in a pair of keyframes.

    Attributes:
        min_deg: minimum parallax of a landmark.
        min_ratio: the same relative to the angle by which its image has moved.
        depth: usual depth where the older keyframe has no landmarks to tell it; None if unknown.
        turns: whether patches are turned as the keyframes are to each other, as in cameras that
            look to different sides.
    """

    min_deg: float
    min_ratio: float
    depth: float | None = None
    turns: bool = False


class _Pair(NamedTuple):
    """Matched features of two keyframes; rows of the arrays belong together.

    Attributes:
        image: (H, W) image of the newer one.
        newer_from_older: (4, 4).
        inverse_depth: 1 over the median depth of the older one's landmarks.
        query: (n,) features of the older one.
        train: (n,) features of the newer one.
        older_xy: (n, 2) ideal pixels in the older one.
        image_xy: (n, 2) pixels in the newer one.
        xy: (n, 2) ideal pixels in the newer one.
    """

    older: Keyframe
    newer: Keyframe
    image: Bytes
    newer_from_older: Floats
    inverse_depth: float
    query: Ints
    train: Ints
    older_xy: Floats
    image_xy: Floats
    xy: Floats

    def select(self, rows: Ints) -> _Pair:
        """Some rows of the matches."""
        return self._replace(
            query=self.query.take(rows),
            train=self.train.take(rows),
            older_xy=self.older_xy.take(rows, axis=0),
            image_xy=self.image_xy.take(rows, axis=0),
            xy=self.xy.take(rows, axis=0),
        )

    def moved(self, chosen: Bools, image_xy: Floats, rig: RectifiedRig) -> _Pair:
        """The matches chosen by a mask (n,), at new pixels (n, 2) in the newer keyframe."""
        rows = chosen.nonzero()[0]
        at = image_xy.take(rows, axis=0)
        xy = at_middle_row(rig, at, self.inverse_depth, self.newer.velocity)
        return self.select(rows)._replace(image_xy=at, xy=xy)


class KeyframeTriangulator:
    """Triangulates features of keyframes against those of earlier keyframes."""

    def __init__(
        self,
        local_map: LocalMap,
        frontend: Frontend,
        config: MappingConfig,
        *,
        of_rig: bool = False,
    ) -> None:
        self._map, self._of_rig = local_map, of_rig
        self._matcher = frontend.matcher
        self._patches = frontend.patches
        self._scale_factor = frontend.scale_factor
        self._config = config

    def add_landmarks(self, keyframe: Keyframe, image: Bytes) -> None:
        """Add landmarks from features that the newest keyframe shares with earlier ones.

        If they are few, those seen while the camera turned are accepted too; if they are so few
        that tracking would be lost, those of very uncertain depth.
        """
        earlier = self._map.keyframes[:-1][-self._config.neighbours :]
        most = len(keyframe.landmark) + self._config.new_per_keyframe
        min_deg = self._config.min_parallax_deg
        for search, wanted in (
            (Search(min_deg, _PARALLAX_RATIO), most),
            (Search(min_deg, 0.0), min(_FEW_LANDMARKS, most)),
            (Search(_MIN_PARALLAX_VERY_FEW_DEG, 0.0), min(_VERY_FEW_LANDMARKS, most)),
        ):
            for older in reversed(earlier):
                room = wanted - len(keyframe.landmark)
                if room > 0:
                    self.triangulate(older, keyframe, image, search, room)

    def triangulate(
        self, older: Keyframe, newer: Keyframe, image: Bytes, search: Search, room: int
    ) -> None:
        """Add at most `room` landmarks of free features of `older` that `newer` sees too."""
        pair = self._match(older, newer, image, search)
        if pair is None:
            return
        points = self._points(pair, search)
        valid = points.valid.nonzero()[0]
        if len(valid) == 0:
            return
        pair = pair.select(valid)
        found = self._align_on_surfaces(pair, points.xyz.take(valid, axis=0))
        good = self._patches.is_found(found)
        good &= distances(found.xy, pair.image_xy) <= _MAX_CORRECTION_PX
        pair = self._at_middle_rows(pair.moved(good, found.xy, self._map.rig), search)
        points = self._points(pair, search)
        chosen = np.flatnonzero(points.valid)
        if len(chosen) > room:
            angle = points.angle[chosen]
            chosen = np.sort(chosen[np.argsort(-angle, kind="stable")[:room]])
        self._add(pair.select(chosen), points.xyz[chosen])

    def _match(
        self, older: Keyframe, newer: Keyframe, image: Bytes, search: Search
    ) -> _Pair | None:
        """Free features that match along epipolar segments and by their patches.

        The keyframes may lie so far behind each other that what is nearest in the older one is
        behind the camera in the newer one.
        """
        newer_from_older = inverse(newer.world_from_cam) @ older.world_from_cam
        depth = self._median_depth(older) or search.depth
        baseline = float(np.linalg.norm(newer_from_older[:3, 3]))
        if depth is None or baseline < _MIN_BASELINE_RATIO * depth:
            return None
        query, train = np.flatnonzero(older.free), np.flatnonzero(newer.free)
        older_xy = older.undistorted_xy.take(query, axis=0)
        start, end, possible = epipolar_segments(
            older_xy,
            newer_from_older,
            _MIN_DEPTH * depth,
            _MAX_DEPTH * depth,
            _MIN_DEPTH_RATIO,
            self._map.rig.intrinsics,
        )
        rows = possible.nonzero()[0]
        start, end = start.take(rows, axis=0), end.take(rows, axis=0)
        size = self._scale_factor ** newer.keypoints.octave[train].astype(np.float64)
        matches = self._matcher.match(
            feature_set(older.keypoints, query.take(rows)),
            feature_set(newer.keypoints, train, newer.undistorted_xy.take(train, axis=0)),
            EpipolarSegments(start, end, tolerance_px=1.5 * size),
        )
        if len(matches.query) == 0:
            return None
        rows, train = rows.take(matches.query), train.take(matches.train)
        guess = newer.keypoints.xy[train].astype(np.float64)
        xy = newer.undistorted_xy.take(train, axis=0)
        if newer.velocity is not None:
            xy = at_middle_row(self._map.rig, guess, 1.0 / depth, newer.velocity)
        views = older, newer, image, newer_from_older, 1.0 / depth
        pair = _Pair(*views, query.take(rows), train, older_xy.take(rows, axis=0), guess, xy)
        return self._aligned(pair, 1.0 + 1.5 * size.take(matches.train), search)

    def _aligned(self, pair: _Pair, reach_px: Floats, search: Search) -> _Pair:
        """The matches whose patches are found within `reach_px` (N,).

        Those are left out whose rays would differ too little there, which most do.
        """
        possible = self._points(pair, search, _MAX_STRETCH * reach_px).valid.nonzero()[0]
        pair, reach_px = pair.select(possible), reach_px.take(possible)
        warp = self._turned(pair.older_xy, pair.newer_from_older) if search.turns else None
        patches = self._patches_of(pair.older, pair.query, warp)
        found = self._patches.align(patches, pair.image, pair.image_xy)
        good = self._patches.is_found(found)
        good &= distances(found.xy, pair.image_xy) <= reach_px
        return pair.moved(good, found.xy, self._map.rig)

    def _patches_of(
        self, keyframe: Keyframe, rows: Ints, reference_from_target: Floats | None = None
    ) -> Patches:
        xy = keyframe.keypoints.xy[rows].astype(np.float64)
        return patches_of(self._map.images[keyframe.slot], xy, reference_from_target)

    def _points(
        self, pair: _Pair, search: Search, reach_px: Floats | None = None
    ) -> TriangulatedPoints:
        """Triangulated points in the frame of the older keyframe, see `triangulate_pixels`."""
        return triangulate_pixels(
            pair.newer_from_older,
            pair.older_xy,
            pair.xy,
            self._map.rig.intrinsics,
            min_parallax_rad=float(np.deg2rad(search.min_deg)),
            min_parallax_ratio=search.min_ratio,
            max_error_px=self._config.gate * self._patches.sigma_px,
            reach_px=reach_px,
        )

    def _at_middle_rows(self, pair: _Pair, search: Search) -> _Pair:
        """The pair with pixels that are corrected for a rolling shutter by their own depths."""
        older, newer, rig = pair.older, pair.newer, self._map.rig
        if older.velocity is None and newer.velocity is None:
            return pair
        points = self._points(pair, search)
        ahead = np.array([0.0, 0.0, 1.0 / pair.inverse_depth])
        xyz = np.where(points.valid[:, None], points.xyz, ahead)
        in_newer = transform_points(pair.newer_from_older, xyz)
        near = 1.0 / xyz[:, 2], np.where(points.valid, 1.0 / in_newer[:, 2], pair.inverse_depth)
        older_xy = older.keypoints.xy[pair.query].astype(np.float64)
        return pair._replace(
            older_xy=at_middle_row(rig, older_xy, near[0], older.velocity),
            xy=at_middle_row(rig, pair.image_xy, near[1], newer.velocity),
        )

    def _align_on_surfaces(self, pair: _Pair, points: Floats) -> Alignment:
        """Align again, with patches warped by the surfaces through neighbouring points (n, 3)."""
        older, rig = pair.older, self._map.rig
        pose = older.world_from_cam
        rows = self._map.rows(older.landmark)
        landmarks = transform_points(inverse(pose), self._map.xyz[rows])
        known = (rows >= 0) & (landmarks[:, 2] > 0)
        xy = np.concatenate([pair.older_xy, older.xy[known]])
        depth = np.concatenate([points[:, 2], landmarks[known, 2]])
        number, first = np.arange(len(points)), np.zeros(len(points), dtype=np.int64)
        seen = predict_patches(
            transform_points(pose, points),
            surface_normals(xy, depth, number, pose, rig.intrinsics),
            first,
            number,
            first + 1,
            np.stack([pose, pair.newer.world_from_cam]),
            rig.intrinsics,
        )
        warp = seen.reference_from_target
        if self._of_rig:
            older_from_newer = inverse(pair.newer_from_older)
            by_target = np.tile(older_from_newer[2], (len(points), 1))
            near = 1.0 / transform_points(pair.newer_from_older, points)[:, 2]
            warp = homographies(warp, seen.xy, by_target, near, seen.slope, rig.intrinsics)
        patches = self._patches_of(older, pair.query, warp)
        return self._patches.align(patches, pair.image, pair.image_xy)

    def _add(self, pair: _Pair, points: Floats) -> None:
        """Add landmarks at points (n, 3) in the older keyframe's frame."""
        older, newer, query = pair.older, pair.newer, pair.query
        in_world = transform_points(older.world_from_cam, points)
        ids = self._map.add_landmarks(in_world, older, query, newer)
        sigma_px = self._patches.sigma_px
        older_xy = older.keypoints.xy[query].astype(np.float64)
        older.add_observations(without_disparity(ids, pair.older_xy, older_xy, sigma_px))
        newer.add_observations(without_disparity(ids, pair.xy, pair.image_xy, sigma_px))
        older.free[query] = False
        newer.free[pair.train] = False

    def _turned(self, xy: Floats, newer_from_older: Floats) -> Floats:
        """Warps (n, 2, 2) to the older keyframe of patches at pixels (n, 2) of far points."""
        rig = self._map.rig
        beside = np.concatenate([xy, xy + (1.0, 0.0), xy + (0.0, 1.0)])
        rays = rig.back_project(beside, np.ones(len(beside))) @ newer_from_older[:3, :3].T
        at, right, down = rig.project(rays).reshape(3, -1, 2)
        return np.asarray(np.linalg.inv(np.stack([right - at, down - at], axis=2)))

    def _median_depth(self, keyframe: Keyframe) -> float | None:
        rows = self._map.rows(keyframe.landmark)
        rows = rows[rows >= 0]
        if len(rows) < _MIN_LANDMARKS:
            return None
        cam_from_world = inverse(keyframe.world_from_cam)
        return median(self._map.xyz[rows] @ cam_from_world[2, :3] + cam_from_world[2, 3])
