"""First maps: from one stereo frame, or from two frames of a single camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.config import Config
from vo.frontend.alignment import align_patches
from vo.frontend.matching import agree_in_rotation, match_everywhere, match_windows
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.neighbours import far_from
from vo.geometry.quantiles import median
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import inverse, transform_points
from vo.mapping.keyframes import add_keyframe
from vo.mapping.local_map import Keyframe, Map
from vo.tracking.two_view import IntermediateView, TwoView, start_two_view
from vo.types import Bools, Floats, Ints

_MOST_WAITING = 30  # frames kept in memory to be placed once there is a map
_ASKED = 4  # of them, spread evenly, tell a plane's two motions apart; those in the middle best


@dataclass(frozen=True, eq=False)
class InitialPair:
    """Two frames that make a map: matched features and what they say of the motion."""

    reference: PreprocessedFrame
    current: PreprocessedFrame
    query: Ints
    image_xy: Floats
    xy: Floats
    two_view: TwoView


class MonocularInitializer:
    """Follows the features of a reference frame until there is enough parallax for a map."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._reference: PreprocessedFrame | None = None
        self._expected_xy: Floats = np.empty((0, 2))
        self.waiting: list[PreprocessedFrame] = []  # the frames since the reference, newest last
        # The reference's features that each of them has seen, and where (ideal pixels).
        self._seen: list[tuple[Ints, Floats]] = []

    def restart(self) -> None:
        """Forget the reference frame."""
        self._reference = None
        self.waiting, self._seen = [], []

    def attempt(self, frame: PreprocessedFrame, rig: RectifiedRig) -> InitialPair | str:
        """A first map from the reference frame and this one, or why there is none yet."""
        if self._reference is None:
            return self._begin(frame, "this is the reference frame")
        query, image_xy = self._match(self._reference, frame, rig)
        if len(query) < self._config.start.min_matches:
            return self._begin(frame, f"{len(query)} matches with the reference frame, too few")
        self._expected_xy[query] = image_xy
        xy = rig.undistort(image_xy)
        reference_xy = rig.undistort(self._reference.keypoints.xy[query])
        asked = np.linspace(0, len(self._seen) - 1, min(_ASKED, len(self._seen)))
        between = [_between(query, *self._seen[int(i)]) for i in asked]
        result = start_two_view(reference_xy, xy, rig.matrix, self._config.start, between)
        if isinstance(result, str):
            self.waiting = [*self.waiting[1 - _MOST_WAITING :], frame]
            self._seen = [*self._seen[1 - _MOST_WAITING :], (query, xy)]
            return result
        return InitialPair(self._reference, frame, query, image_xy, xy, result)

    def _begin(self, frame: PreprocessedFrame, reason: str) -> str:
        self._reference = frame
        self.waiting, self._seen = [], []
        self._expected_xy = frame.keypoints.xy.astype(np.float64)
        return reason

    def _match(
        self, reference: PreprocessedFrame, frame: PreprocessedFrame, rig: RectifiedRig
    ) -> tuple[Ints, Floats]:
        """Features of the reference found in the frame, and where, to sub-pixel."""
        tracking = self._config.tracking
        a, b = reference.keypoints, frame.keypoints
        radius = np.full(len(a), 4.0 * tracking.search_share * rig.width)
        matched = match_windows(
            self._expected_xy,
            a.octave,
            a.descriptor,
            radius,
            b.xy,
            b.octave,
            b.descriptor,
            max_distance=tracking.max_hamming,
            ratio=tracking.ratio,
        )
        if int((matched >= 0).sum()) < self._config.start.min_matches:
            matched = match_everywhere(
                a.descriptor,
                b.descriptor,
                max_distance=tracking.max_hamming,
                ratio=tracking.ratio,
            )
        query = np.flatnonzero(matched >= 0)
        query = query[agree_in_rotation(a.angle[query], b.angle[matched[query]])]
        start = b.xy[matched[query]].astype(np.float64)
        found = align_patches(
            reference.image0[None],
            np.zeros(len(query), dtype=np.int64),
            a.xy[query].astype(np.float64),
            np.tile(np.eye(2), (len(query), 1, 1)),
            frame.image0,
            start,
            half_px=tracking.patch_half_px,
        )
        size = self._config.features.scale_factor ** b.octave[matched[query]]
        good = found.converged & (found.score >= tracking.min_patch_score)
        good &= np.linalg.norm(found.xy - start, axis=1) <= 1.0 + 1.5 * size
        return query[good], found.xy[good]


def map_from_pair(
    world: Map,
    pair: InitialPair,
    anchor: Floats,
    median_depth: float,
    segment: int,
    rig: RectifiedRig,
    sigma_px: float,
) -> tuple[Keyframe, Keyframe]:
    """Two keyframes and their landmarks, scaled to a median depth; the first is at `anchor`."""
    good, points = pair.two_view.good, pair.two_view.points
    scale = median_depth / median(points[good, 2])
    motion = pair.two_view.second_from_first.copy()
    motion[:3, 3] *= scale
    query, in_world = pair.query[good], transform_points(anchor, points[good] * scale)
    others = _others(pair.reference, query)
    first = add_keyframe(world, pair.reference, anchor, segment, others, rig)
    first.covariance = np.zeros((6, 6))  # what comes later is measured against it
    taken = pair.image_xy[good]
    free = far_from(pair.current.keypoints.xy, taken)
    second = add_keyframe(world, pair.current, anchor @ inverse(motion), segment, free, rig)
    keypoints = pair.reference.keypoints
    reference_xy = keypoints.xy[query].astype(np.float64)
    ids = world.add_landmarks(
        in_world,
        keypoints.descriptor[query],
        keypoints.octave[query],
        keypoints.angle[query],
        first,
        reference_xy,
        second,
    )
    none, sigma = np.full(len(ids), np.nan), np.full(len(ids), sigma_px)
    first.add_observations(ids, first.undistorted_xy[query], reference_xy, none, sigma)
    second.add_observations(ids, pair.xy[good], taken, none, sigma)
    return first, second


def _between(query: Ints, seen: Ints, xy: Floats) -> IntermediateView:
    """Which of the features `query` were among those seen, by row."""
    _, rows, there = np.intersect1d(query, seen, assume_unique=True, return_indices=True)
    return IntermediateView(rows, xy[there])


def _others(frame: PreprocessedFrame, used: Ints) -> Bools:
    free = np.ones(len(frame.keypoints), dtype=bool)
    free[used] = False
    return free
