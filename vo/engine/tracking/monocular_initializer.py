"""First map of a single camera, from two frames with enough parallax."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.base.config import StartConfig
from vo.base.failures import Failure, FailureReason
from vo.base.frozen import frozen
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import inverse, so3_log, transform_points
from vo.base.types import Floats, Ints
from vo.engine.frontend.contracts import Circles, Matches, feature_set
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.matching import with_common_rotation
from vo.engine.frontend.optical_flow import follow
from vo.engine.frontend.patch_alignment import patches_of
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.neighbours import far_from
from vo.engine.mapping.keyframe import Keyframe, without_disparity
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.tracking.two_view import IntermediateView, MatchedViews, TwoView, reconstruct

if TYPE_CHECKING:
    from vo.engine.inertial.prediction import InertialPredictor

_MAX_WAITING = 30  # frames kept in memory, to be tracked in the first map
_INTERMEDIATE_VIEWS = 4  # of them, evenly spread, that decide between two motions
_MEDIAN_DEPTH = 1.0  # of the first map of each segment, whose scale is free
_MAX_DIFFERENCE_RAD = 0.02  # of the rotation by two images from that of the gyroscope
_SEARCH_FACTOR = 4.0  # search radius in units of that of tracking


@frozen(eq=False)
class InitialPair:
    """Two frames that make a map.

    Attributes:
        reference: the first frame.
        current: the second frame.
        query: (N,) matched features of the first frame.
        image_xy: (N, 2) their pixels in the second frame.
        xy: (N, 2) the same as ideal pixels.
    """

    reference: PreprocessedFrame
    current: PreprocessedFrame
    query: Ints
    image_xy: Floats
    xy: Floats
    two_view: TwoView


class MonocularInitializer:
    """Tracks the features of a reference frame until there is enough parallax for a map.

    Attributes:
        waiting: the frames since the reference frame, newest last.

    Args:
        search_ratio: radius of the search windows in tracking, ratio of the image width.
        by_flow: whether features are followed by optical flow instead of being matched.
        predictor: receives the rotations between images, and refuses motions whose rotation is
            not that of the gyroscope; None without an inertial sensor.
    """

    def __init__(
        self,
        local_map: LocalMap,
        mapper: LocalMapper,
        frontend: Frontend,
        config: StartConfig,
        search_ratio: float,
        *,
        by_flow: bool = False,
        predictor: InertialPredictor | None = None,
    ) -> None:
        self.waiting: list[PreprocessedFrame] = []
        self._map = local_map
        self._mapper = mapper
        self._frontend = frontend
        self._config = config
        self._radius_ratio = _SEARCH_FACTOR * search_ratio
        self._by_flow = by_flow
        self._predictor = predictor
        self._reference: PreprocessedFrame | None = None
        self._expected_xy: Floats = np.empty((0, 2))
        # Features of the reference frame that each waiting frame shows, and their ideal pixels.
        self._seen: list[tuple[Ints, Floats]] = []

    @property
    def has_reference(self) -> bool:
        """Whether there is a reference frame."""
        return self._reference is not None

    def restart(self) -> None:
        """Forget the reference frame."""
        self._reference = None
        self.waiting, self._seen = [], []

    def attempt(self, frame: PreprocessedFrame) -> InitialPair | Failure:
        """A pair of the reference frame and this one, or why it makes no map yet."""
        features, needed = len(frame.keypoints), self._config.min_matches
        if features < needed:
            self._set_reference(frame)
            return Failure(FailureReason.FEW_FEATURES, features, needed)
        if self._reference is None:
            self._set_reference(frame)
            return Failure(FailureReason.REFERENCE_FRAME)
        query, image_xy = self._match(self._reference, frame)
        if len(query) < needed:
            self._set_reference(frame)
            return Failure(FailureReason.FEW_MATCHES, len(query), needed)
        self._expected_xy[query] = image_xy
        rig = self._map.rig
        xy = rig.undistort(image_xy)
        views = MatchedViews(
            rig.undistort(self._reference.keypoints.xy[query]),
            xy,
            rig.matrix,
            self._intermediate_views(query),
        )
        times_ns = self._reference.stamp_ns, frame.stamp_ns
        if self._predictor is not None:
            self._predictor.turns.add(times_ns, views.first, views.second, views.matrix)
        result = self._confirmed(reconstruct(views, self._config), times_ns)
        if isinstance(result, Failure):
            self.waiting = [*self.waiting[1 - _MAX_WAITING :], frame]
            self._seen = [*self._seen[1 - _MAX_WAITING :], (query, xy)]
            return result
        return InitialPair(self._reference, frame, query, image_xy, xy, result)

    def _confirmed(self, result: TwoView | Failure, times_ns: tuple[int, int]) -> TwoView | Failure:
        """A motion, unless the gyroscope, once its bias is known, measures another rotation."""
        turned = None if self._predictor is None else self._predictor.turned(*times_ns)
        if turned is None or isinstance(result, Failure):
            return result
        difference = float(np.linalg.norm(so3_log(result.second_from_first[:3, :3] @ turned)))
        if difference <= _MAX_DIFFERENCE_RAD:
            return result
        return Failure(FailureReason.OTHER_ROTATION, float(np.degrees(difference)))

    def create_map(
        self, pair: InitialPair, world_from_cam: Floats, segment: int
    ) -> tuple[Keyframe, Keyframe]:
        """Replace the map by the keyframes and landmarks of a pair, the first at a pose (4, 4)."""
        self._map.clear()
        good, points = pair.two_view.good, pair.two_view.points
        scale = _MEDIAN_DEPTH / median(points[good, 2])
        motion = pair.two_view.second_from_first.copy()
        motion[:3, 3] *= scale
        query, image_xy = pair.query[good], pair.image_xy[good]
        unused = np.ones(len(pair.reference.keypoints), dtype=bool)
        unused[query] = False
        first = self._mapper.add_first_keyframe(pair.reference, world_from_cam, segment, unused)
        free = far_from(pair.current.keypoints.xy, image_xy)
        second_pose = world_from_cam @ inverse(motion)
        second = self._mapper.add_keyframe_at(pair.current, second_pose, segment, free)
        in_world = transform_points(world_from_cam, points[good] * scale)
        ids = self._map.add_landmarks(in_world, first, query, second)
        reference_xy = pair.reference.keypoints.xy[query].astype(np.float64)
        sigma_px = self._frontend.patches.sigma_px
        first.add_observations(
            without_disparity(ids, first.undistorted_xy[query], reference_xy, sigma_px)
        )
        second.add_observations(without_disparity(ids, pair.xy[good], image_xy, sigma_px))
        return first, second

    def _set_reference(self, frame: PreprocessedFrame) -> None:
        self._reference = frame
        self.waiting, self._seen = [], []
        self._expected_xy = frame.keypoints.xy.astype(np.float64)

    def _intermediate_views(self, query: Ints) -> list[IntermediateView]:
        """Some waiting frames as views of the matches of features `query`."""
        count = min(_INTERMEDIATE_VIEWS, len(self._seen))
        views = []
        for i in np.linspace(0, len(self._seen) - 1, count):
            seen, xy = self._seen[int(i)]
            _, rows, at = np.intersect1d(query, seen, assume_unique=True, return_indices=True)
            views.append(IntermediateView(rows, xy[at]))
        return views

    def _match(self, reference: PreprocessedFrame, frame: PreprocessedFrame) -> tuple[Ints, Floats]:
        """Features of the reference frame found in a frame, and their pixels there (n, 2)."""
        if self._by_flow:
            xy = reference.keypoints.xy
            flow = follow(reference.image0, frame.image0, xy, self._expected_xy)
            return np.flatnonzero(flow.found), flow.xy[flow.found]
        matches = self._match_descriptors(reference, frame)
        a, b, query = reference.keypoints, frame.keypoints, matches.query
        start = b.xy[matches.train].astype(np.float64)
        patches = self._frontend.patches
        references = patches_of(reference.image0, a.xy[query].astype(np.float64))
        found = patches.align(references, frame.image0, start)
        size = self._frontend.scale_factor ** b.octave[matches.train]
        good = patches.is_found(found)
        good &= np.linalg.norm(found.xy - start, axis=1) <= 1.0 + 1.5 * size
        return query[good], found.xy[good]

    def _match_descriptors(self, reference: PreprocessedFrame, frame: PreprocessedFrame) -> Matches:
        """Matches near the pixels in the frame before, or anywhere if these are too few."""
        a, b, matcher = reference.keypoints, frame.keypoints, self._frontend.matcher
        size = self._map.rig.width, self._map.rig.height
        radius_px = np.full(len(a), self._radius_ratio * size[0])
        query, train = feature_set(a, xy=self._expected_xy), feature_set(b, size=size)
        matches = matcher.match(query, train, Circles(radius_px), check_rotation=False)
        if len(matches.query) < self._config.min_matches:
            return matcher.match(feature_set(a, size=size), train)
        return with_common_rotation(matches, query, train)
