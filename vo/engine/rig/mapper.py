"""Keyframes and landmarks of a rig: an instant is one keyframe for every view."""

from __future__ import annotations

import numpy as np

from vo.base.config import MappingConfig
from vo.base.geometry.transforms import rotation_angle
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Floats
from vo.engine.frontend.frontend import Frontend
from vo.engine.geometry.neighbours import far_from
from vo.engine.mapping.keyframe import Keyframe, without_disparity
from vo.engine.mapping.keyframe_triangulation import KeyframeTriangulator, Search
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.mapping.patch_search import find_patches
from vo.engine.mapping.tracked_frame import TrackedFrame, as_tracked_frame
from vo.engine.rig.frames import RigFrame
from vo.engine.rig.tracked import RigTracked, unobserved

_LANDMARKS = 1000  # wanted in all views of an instant, in each at least the second number
_MIN_LANDMARKS = 150
_SAME_PLACE = 1e-9  # distance of views that are those of one lens
# Minimum parallax of landmarks of one instant, whose views are known relative to each other; and
# the usual depth, in baselines, where a view has no landmarks yet.
_MIN_PARALLAX_DEG, _DEPTH_RATIO = 0.6, 15.0
# Views whose axes differ by more than this have nothing in common; patches are turned from the
# second on.
_MAX_TURN_RAD, _TURNED_RAD = np.deg2rad(100.0), np.deg2rad(15.0)
_MOTION = Search(1.1, 0.12)  # between instants, as of a single camera
_FEW_MOTION = Search(1.1, 0.0)  # where a view has few landmarks
_FEW_RATIO = 0.4  # of the wanted landmarks
_SEARCHED_INSTANTS = 2  # in which new landmarks are searched


class RigMapper:
    """Adds the views of a frame as keyframes, and landmarks that two of them see.

    Attributes:
        stopwatch: measures the stage `map`.
    """

    def __init__(
        self,
        local_map: LocalMap,
        frontend: Frontend,
        config: MappingConfig,
        stopwatch: Stopwatch,
        views: int,
    ) -> None:
        self.stopwatch = stopwatch
        self._map = local_map
        self._patches = frontend.patches
        self._views = views
        self._config = config
        self._mapper = LocalMapper(local_map, frontend, config, stopwatch)
        self._triangulator = KeyframeTriangulator(local_map, frontend, config, of_rig=True)
        self._wanted = max(_MIN_LANDMARKS, _LANDMARKS // views)

    @property
    def newest(self) -> list[Keyframe]:
        """The keyframes of the newest instant."""
        return self._map.keyframes[-self._views :]

    def add_instant(self, frame: RigFrame, tracked: RigTracked, segment: int) -> Keyframe:
        """Add all views of a tracked frame, with their observations; the first is the body's."""
        for view, seen in zip(frame.views, tracked.views, strict=True):
            self._mapper.add_keyframe(view, seen, segment)
        for keyframe, is_used in zip(self.newest, frame.used, strict=True):
            if not is_used:
                keyframe.free[:] = False
        return self.newest[0]

    def add_first_instant(
        self, frame: RigFrame, world_from_body: Floats, tied: Floats, segment: int
    ) -> Keyframe:
        """Add a frame without observations, at a pose (4, 4) with body_from_views (V, 4, 4)."""
        views = tuple(
            TrackedFrame(world_from_body @ pose, np.empty(0, np.int64), unobserved(), _NONE, 0)
            for pose in tied
        )
        keyframe = self.add_instant(frame, RigTracked(world_from_body, tied, views), segment)
        keyframe.covariance = np.zeros((6, 6))
        return keyframe

    @timed("map")
    def extend(self, frame: RigFrame, depth: float | None = None) -> None:
        """Add landmarks that the newest instant's views share with each other, and with earlier.

        `depth`: usual depth where a view has no landmarks.
        """
        newest = self.newest
        for view, keyframe in enumerate(newest):
            image = frame.views[view].image0
            for other in newest[:view]:
                self._triangulate_rig(other, keyframe, frame, view)
            earlier = self._map.keyframes[: -self._views][view :: self._views]
            for older in reversed(earlier[-self._config.neighbours :]):
                for search, wanted in (
                    (_MOTION, self._wanted),
                    (_FEW_MOTION, int(_FEW_RATIO * self._wanted)),
                ):
                    room = wanted - len(keyframe.landmark)
                    if room > 0:
                        self._triangulator.triangulate(
                            older, keyframe, image, search._replace(depth=depth), room
                        )
        for keyframe in newest:
            self._mapper.estimate_normals(keyframe, only_new=True)
        self._observe_elsewhere()

    def as_tracked(self, tied: Floats) -> RigTracked:
        """The newest instant as if it had been tracked; `tied`: body_from_views (V, 4, 4)."""
        views = tuple(as_tracked_frame(self._map, keyframe) for keyframe in self.newest)
        return RigTracked(self.newest[0].world_from_cam, tied, views)

    def cull(self) -> None:
        """Remove landmarks that are seldom found, or observed by too few keyframes."""
        self._mapper.cull()

    def estimate_normals(self) -> None:
        """Estimate the normals of the landmarks of the newest instant anew."""
        for keyframe in self.newest:
            if len(keyframe.landmark):
                self._mapper.estimate_normals(keyframe)

    def _triangulate_rig(
        self, older: Keyframe, newer: Keyframe, frame: RigFrame, view: int
    ) -> None:
        """Landmarks that two views of one instant share: their relative pose is known."""
        room = self._wanted - len(newer.landmark)
        apart = np.linalg.norm(older.world_from_cam[:3, 3] - newer.world_from_cam[:3, 3])
        turn = _axis_angle(older, newer)
        if room <= 0 or apart < _SAME_PLACE or turn > _MAX_TURN_RAD:
            return
        relative = older.world_from_cam[:3, :3].T @ newer.world_from_cam[:3, :3]
        turns = rotation_angle(relative) > _TURNED_RAD
        search = Search(_MIN_PARALLAX_DEG, 0.0, _DEPTH_RATIO * float(apart), turns)
        self._triangulator.triangulate(older, newer, frame.views[view].image0, search, room)

    def _observe_elsewhere(self) -> None:
        """Find the new landmarks in the other views, now and shortly before."""
        local_map, first = self._map, self.newest[0].id
        new = np.flatnonzero((local_map.last_seen >= first) & (local_map.found <= 1))
        others = local_map.keyframes[-(1 + _SEARCHED_INSTANTS) * self._views :]
        if len(new) == 0:
            return
        unseen = [~np.isin(local_map.id[new], k.landmark) for k in others]
        rows = np.concatenate([new[mask] for mask in unseen])
        camera = np.repeat(np.arange(len(others)), [np.count_nonzero(mask) for mask in unseen])
        camera += len(local_map.keyframes) - len(others)
        found = find_patches(local_map, rows, camera, self._patches, of_rig=True)
        for number, other in enumerate(local_map.keyframes):
            here = found.camera == number
            if here.any():
                ids, places = local_map.id[found.rows[here]], (found.xy[here], found.image_xy[here])
                other.add_observations(without_disparity(ids, *places, self._patches.sigma_px))
                other.free &= far_from(other.keypoints.xy, places[1])


_NONE = np.empty(0, dtype=bool)


def _axis_angle(first: Keyframe, second: Keyframe) -> float:
    """Angle between the optical axes of two keyframes."""
    cosine = float(first.world_from_cam[:3, 2] @ second.world_from_cam[:3, 2])
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))
