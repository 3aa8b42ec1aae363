"""Second, small implementations of the extractor's and the matcher's contracts."""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.config import MatchingConfig, load_config
from vo.base.geometry.similarity import umeyama
from vo.base.types import Bools, Bytes, Floats, Keypoints, State
from vo.engine.frontend.contracts import (
    Circles,
    DescriptorFormat,
    EpipolarSegments,
    FeatureSet,
    Matches,
    SearchRegion,
)
from vo.engine.frontend.matching import HammingMatcher
from vo.engine.odometry import Odometry
from vo.engine.stages import Components
from vo.recordings.sources.registry import open_source

SIDE = 8  # of a described patch, pixels
FRAMES = 12


class PatchExtractor:
    """Corners of one scale, described by their grey levels; without orientation."""

    descriptor_format = DescriptorFormat(SIDE * SIDE, np.dtype(np.float32))
    scale_factor = 1.0

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        corners = cv2.goodFeaturesToTrack(image, 800, 0.005, 6, mask=mask)
        xy = np.empty((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
        inside = ((xy > SIDE) & (xy < np.array(image.shape[::-1]) - SIDE)).all(axis=1)
        xy = xy[inside]
        patches = [cv2.getRectSubPix(image, (SIDE, SIDE), (float(u), float(v))) for u, v in xy]
        grey = np.array(patches, np.float32).reshape(len(xy), SIDE * SIDE)
        grey -= grey.mean(axis=1, keepdims=True)
        grey /= np.maximum(np.linalg.norm(grey, axis=1, keepdims=True), 1e-6)
        count = len(xy)
        return Keypoints(
            xy,
            np.zeros(count, np.int32),
            np.full(count, np.nan, np.float32),
            np.arange(count, 0, -1).astype(np.float32),
            grey,
        )


class NearestMatcher:
    """Mutual nearest neighbours by Euclidean distance, with a ratio test."""

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        PatchExtractor.descriptor_format.check(query.descriptor)
        PatchExtractor.descriptor_format.check(train.descriptor)
        if len(query) == 0 or len(train) < 2:
            return Matches(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
        distance = 2.0 - 2.0 * (query.descriptor @ train.descriptor.T).astype(np.float64)
        distance[~_allowed(query, train, region)] = np.inf
        best = np.argmin(distance, axis=1)
        first, second = np.partition(distance, 1, axis=1)[:, :2].T
        good = (first < 0.5) & (first < (ratio or 0.85) * second)
        good &= np.argmin(distance, axis=0)[best] == np.arange(len(query))
        rows = np.flatnonzero(good)
        return Matches(rows, best[rows], first[rows])


def _allowed(query: FeatureSet, train: FeatureSet, region: SearchRegion) -> Bools:
    """(N, M) pairs inside the search region."""
    if region is None:
        return np.ones((len(query), len(train)), dtype=bool)
    assert train.xy is not None
    if isinstance(region, Circles):
        assert query.xy is not None
        away = np.linalg.norm(query.xy[:, None] - train.xy[None], axis=2)
        return np.asarray(away <= region.radius_px[:, None])
    assert isinstance(region, EpipolarSegments)
    along = region.end - region.start
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    offset = train.xy[None] - region.start[:, None]
    unit = along / length
    at = np.einsum("nmi,ni->nm", offset, unit).clip(0.0, length)
    nearest = region.start[:, None] + at[..., None] * unit[:, None]
    away = np.linalg.norm(train.xy[None] - nearest, axis=2)
    return np.asarray(away <= region.tolerance_px[None])


def _positions(folder: Path, mode: str) -> tuple[Floats, Floats]:
    """Positions of a run with the small extractor and matcher, and the true ones."""
    source = open_source(folder, mode=mode)
    components = Components(extractor=PatchExtractor(), matcher=NearestMatcher())
    config = load_config("fast", ["threads=1"])
    with closing(Odometry(source.rig, config, components)) as odometry:
        estimates = list(odometry.track_all(source.frames(0, FRAMES)))
        odometry.finish()
        path = odometry.trajectory.trajectory()
    assert estimates[-1].state is State.TRACKING
    truth = source.ground_truth
    assert truth is not None
    rows = np.searchsorted(truth.stamps_ns, path.stamps_ns)
    return path.positions, truth.positions[rows]


@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_the_odometry_works_with_other_features_and_another_matcher(
    synthetic_stereo: Path, mode: str
) -> None:
    found, truth = _positions(synthetic_stereo, mode)
    assert len(found) >= FRAMES - 4
    fit = umeyama(found, truth, with_scale=mode == "mono")
    errors = np.linalg.norm(fit.transform_points(found) - truth, axis=1)
    length = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    assert np.sqrt(np.mean(errors**2)) < 0.01 * length


@pytest.mark.parametrize(
    ("descriptor", "given"),
    [
        (np.zeros((100, 128), np.uint8), "100 x 128 of uint8"),
        (np.zeros((100, 32), np.float32), "100 x 32 of float32"),
        (np.zeros(3200, np.uint8), "3200 of uint8"),
    ],
)
def test_the_hamming_matcher_refuses_descriptors_of_another_layout(
    descriptor: np.ndarray, given: str
) -> None:
    count = 100
    octave, angle = np.zeros(count, np.int32), np.zeros(count, np.float32)
    right = FeatureSet(None, octave, angle, np.zeros((count, 32), np.uint8))
    wrong = FeatureSet(None, octave, angle, descriptor)
    matcher = HammingMatcher(MatchingConfig())
    for query, train in ((right, wrong), (wrong, right)):
        with pytest.raises(ValueError, match=f"array {given}, expected N x 32 x uint8"):
            matcher.match(query, train)


def test_features_without_orientation_are_matched_by_descriptor_alone() -> None:
    rng = np.random.default_rng(0)
    descriptor = rng.integers(0, 256, (50, 32), dtype=np.uint8)
    octave, angle = np.zeros(50, np.int32), np.full(50, np.nan, np.float32)
    features = FeatureSet(None, octave, angle, descriptor)
    matches = HammingMatcher(MatchingConfig()).match(features, features)
    assert matches.query.tolist() == matches.train.tolist() == list(range(50))
    assert matches.score.tolist() == [0.0] * 50
