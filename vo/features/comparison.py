"""Comparison of methods on pairs of images whose relative pose is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from vo.features.methods import Method, PairMatches
from vo.geometry import epipolar
from vo.geometry.rectification import RectifiedRig, rectified_rig
from vo.geometry.transforms import inverse, rotation_angle
from vo.types import Bytes, Camera, Floats, Ints, Rig

MAX_ERROR_DEG = 2.0
_THRESHOLD_PX = 1.0  # of inliers of the essential matrix
_CORRECT_PX = 2.0  # from the true epipolar line, in both images
_MIN_BASELINE_M = 0.02  # without translation its direction is undefined
_FAILED_DEG = 180.0


class ImagePair(NamedTuple):
    """Two images of one camera.

    Attributes:
        gap: frames between them.
        first: (H, W) uint8.
        second: (H, W) uint8.
        second_from_first: (4, 4) true motion.
    """

    gap: int
    first: Bytes
    second: Bytes
    second_from_first: Floats


class PairScore(NamedTuple):
    """What a method reached on a pair.

    Attributes:
        features: in the first image.
        matches: number of matches.
        correct: matches that agree with the true motion.
        inliers: matches that agree with the estimated one.
        rotation_deg: error of the estimated rotation, 180 if there is none.
        direction_deg: error of the direction of translation; NaN where there is no translation.
        extract_ms: CPU time of detection and description, per image.
        match_ms: CPU time of matching.
    """

    features: int
    matches: int
    correct: int
    inliers: int
    rotation_deg: float
    direction_deg: float
    extract_ms: float
    match_ms: float

    @property
    def error_deg(self) -> float:
        """The larger one of both errors."""
        return float(np.nanmax([self.rotation_deg, self.direction_deg]))


@dataclass(frozen=True)
class Comparison:
    """Scores of a method over the pairs of a gap: means of counts and times, medians of errors.

    Attributes:
        method: name of the method.
        gap: frames between the images.
        pairs: number of pairs.
        features: per image.
        matches: per pair.
        matching_score: ratio of features that were matched correctly.
        precision: ratio of matches that are correct.
        inlier_ratio: ratio of matches that agree with the estimated motion.
        good_ratio: ratio of pairs with errors of rotation and direction below 2 degrees.
        rotation_deg: median error of the rotation.
        direction_deg: median error of the direction of translation, NaN without translation.
        extract_ms: CPU time of detection and description per image.
        match_ms: CPU time of matching per pair.
    """

    method: str
    gap: int
    pairs: int
    features: float
    matches: float
    matching_score: float
    precision: float
    inlier_ratio: float
    good_ratio: float
    rotation_deg: float
    direction_deg: float
    extract_ms: float
    match_ms: float


def choose_pairs(count: int, gaps: Sequence[int], wanted: int) -> Iterator[tuple[int, Ints]]:
    """For each gap, numbers of at most `wanted` first frames of `count`, evenly spread."""
    for gap in gaps:
        last = count - gap
        if last > 0:
            yield gap, np.unique(np.linspace(0, last - 1, min(wanted, last)).round().astype(int))


def score_pair(method: Method, pair: ImagePair, camera: RectifiedRig) -> PairScore:
    """Match a pair and estimate its motion.

    Args:
        method: finds matches.
        pair: the images.
        camera: of both, as `rectified_rig` gives it for a single camera.
    """
    found = method.match(pair.first, pair.second)
    first, second = camera.undistort(found.first), camera.undistort(found.second)
    usable = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    first, second = first[usable], second[usable]
    inliers, rotation_deg, direction_deg = _motion_errors(pair, first, second, camera.matrix)
    return PairScore(
        found.counts[0],
        len(first),
        _count_correct(pair, first, second, camera.matrix),
        inliers,
        rotation_deg,
        direction_deg,
        found.extract_ms / 2.0,
        found.match_ms,
    )


def summarise(method: str, gap: int, scores: Sequence[PairScore]) -> Comparison:
    """The scores of one method over all pairs of a gap."""
    table = np.array([tuple(score) for score in scores], dtype=np.float64)
    features, matches, correct, inliers = table[:, :4].T
    direction = table[:, 5][np.isfinite(table[:, 5])]
    extract_ms, match_ms = table[:, 6:].mean(axis=0).tolist()
    return Comparison(
        method,
        gap,
        len(scores),
        float(features.mean()),
        float(matches.mean()),
        _ratio(correct, features),
        _ratio(correct, matches),
        _ratio(inliers, matches),
        float(np.mean([score.error_deg < MAX_ERROR_DEG for score in scores])),
        float(np.median(table[:, 4])),
        float(np.median(direction)) if len(direction) else float("nan"),
        extract_ms,
        match_ms,
    )


def compare(
    methods: Sequence[Method],
    pairs: Sequence[ImagePair],
    camera: Camera,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Comparison]:
    """Score methods on pairs of images, one after the other, in one thread.

    Args:
        methods: what to compare.
        pairs: of one camera, in order of their gaps.
        camera: as recorded.
        progress: called with the name of a method before each pair.
    """
    rig = rectified_rig(Rig(camera))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        rows = []
        for method in methods:
            scores: dict[int, list[PairScore]] = {}
            method.match(pairs[0].first, pairs[0].first)  # what is loaded at first use
            for pair in pairs:
                progress(method.name)
                scores.setdefault(pair.gap, []).append(score_pair(method, pair, rig))
            rows += [summarise(method.name, gap, each) for gap, each in scores.items()]
        return rows
    finally:
        cv2.setNumThreads(threads)


def repeatability(method: Method, pair: tuple[Bytes, Bytes], second_from_first: Floats) -> float:
    """Ratio of features that are found again, of a plane with a known homography (3, 3).

    A feature counts if it lies in both images; it is repeated if one of the other image lies within
    2 pixels of where the homography takes it.

    Source: Mikolajczyk et al., "A comparison of affine region detectors", IJCV 2005, section 4.
    """
    first, second = (method.detect(image) for image in pair)
    there = _transferred(first, second_from_first)
    back = _transferred(second, np.asarray(np.linalg.inv(second_from_first), dtype=np.float64))
    there = there[_inside(there, pair[1])]
    back_inside = _inside(back, pair[0])
    second = second[back_inside]
    fewer = min(len(there), len(second))
    if fewer == 0:
        return 0.0
    away = np.linalg.norm(there[:, None] - second[None], axis=2)
    is_nearest = away.argmin(axis=0)[away.argmin(axis=1)] == np.arange(len(there))
    return float(np.count_nonzero(is_nearest & (away.min(axis=1) <= _CORRECT_PX)) / fewer)


def correct_by_homography(found: PairMatches, second_from_first: Floats) -> int:
    """Number of matches within 2 pixels of where a homography (3, 3) takes them."""
    there = _transferred(found.first, second_from_first)
    away = np.linalg.norm(there - found.second, axis=1)
    return int(np.count_nonzero(away <= _CORRECT_PX))


def _transferred(xy: Floats, homography: Floats) -> Floats:
    mapped = np.column_stack([xy, np.ones(len(xy))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _inside(xy: Floats, image: Bytes) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    height, width = image.shape
    return np.asarray(((xy >= 0) & (xy <= [width - 1, height - 1])).all(axis=1))


def _motion_errors(
    pair: ImagePair, first: Floats, second: Floats, matrix: Floats
) -> tuple[int, float, float]:
    """Inliers of the estimated motion, and its errors in degrees."""
    truth = pair.second_from_first
    baseline = float(np.linalg.norm(truth[:3, 3]))
    has_direction = baseline >= _MIN_BASELINE_M
    failed = _FAILED_DEG if has_direction else float("nan")
    essential = epipolar.find_essential(first, second, matrix, _THRESHOLD_PX)
    if essential is None:
        return 0, _FAILED_DEG, failed
    model, inlier = essential
    motion = epipolar.recover_motion(model, first, second, matrix, inlier)
    rotation = rotation_angle(motion[:3, :3].T @ truth[:3, :3])
    direction_deg = float("nan")
    if has_direction:
        cosine = float(motion[:3, 3] @ truth[:3, 3]) / baseline
        direction_deg = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return int(inlier.sum()), float(np.rad2deg(rotation)), direction_deg


def _count_correct(pair: ImagePair, first: Floats, second: Floats, matrix: Floats) -> int:
    """Matches near their true epipolar lines; without translation, near their true places."""
    truth = pair.second_from_first
    if len(first) == 0:
        return 0
    if np.linalg.norm(truth[:3, 3]) < _MIN_BASELINE_M:
        turned = matrix @ truth[:3, :3] @ np.linalg.inv(matrix)
        away = np.linalg.norm(_transferred(first, turned) - second, axis=1)
        return int(np.count_nonzero(away <= _CORRECT_PX))
    fundamental = epipolar.fundamental_from_motion(truth, matrix)
    errors = np.maximum(*epipolar.epipolar_errors(fundamental, first, second))
    return int(np.count_nonzero(errors <= _CORRECT_PX**2))


def _ratio(part: Floats, whole: Floats) -> float:
    total = float(whole.sum())
    return float(part.sum()) / total if total > 0 else 0.0


def true_motion(world_from_first: Floats, world_from_second: Floats) -> Floats:
    """second_from_first (4, 4) of two true poses."""
    return np.asarray(inverse(world_from_second) @ world_from_first)
