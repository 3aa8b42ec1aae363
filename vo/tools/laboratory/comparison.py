"""Comparison of methods on pairs of images whose relative pose is known, as of a recording."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.base.errors import EvaluationError, SourceError
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.scheduling import one_opencv_thread
from vo.base.types import Bools, Bytes, Camera, Floats, Floats32, Frame, Ints, Rig, Trajectory
from vo.engine.geometry import epipolar
from vo.outputs.evaluation.association import associate
from vo.recordings.sources.source import Recording
from vo.tools.laboratory.methods import Method
from vo.tools.laboratory.repeatability import CORRECT_PX, by_depth, repeatability, transferred

_log = logging.getLogger(__name__)
MAX_ERROR_DEG = 2.0
_THRESHOLD_PX = 1.0  # of inliers of the essential matrix
_MIN_BASELINE_M = 0.02  # without translation its direction is undefined
_FAILED_DEG = 180.0


class ImagePair(NamedTuple):
    """Two images of one camera."""

    gap: int
    first: Bytes  # (H, W) uint8
    second: Bytes  # (H, W) uint8
    second_from_first: Floats  # (4, 4) true motion
    # (H, W) metres at the pixels of both images, 0 where unknown; None without depth
    depths: tuple[Floats32, Floats32] | None = None


class PairScore(NamedTuple):
    """What a method reached on a pair."""

    features: int
    matches: int
    correct: int  # matches that agree with the true motion
    inliers: int  # matches that agree with the estimated one
    rotation_deg: float  # error of the estimated rotation, 180 if there is none
    direction_deg: float  # error of the direction of translation; NaN where there is no translation
    extract_ms: float  # CPU time of detection and description, per image
    match_ms: float  # CPU time of matching
    repeatability: float = float("nan")  # ratio of features that are found again; NaN without depth

    @property
    def error_deg(self) -> float:
        """The larger one of both errors."""
        return float(np.nanmax([self.rotation_deg, self.direction_deg]))


@dataclass(frozen=True)
class Comparison:
    """Scores of a method over the pairs of a gap: means of counts and times, medians of errors."""

    method: str
    gap: int  # frames between the images
    pairs: int
    features: float
    matches: float
    matching_score: float  # ratio of features that were matched correctly
    precision: float  # ratio of matches that are correct
    inlier_ratio: float  # ratio of matches that agree with the estimated motion
    good_ratio: float  # ratio of pairs with errors of rotation and direction below 2 degrees
    rotation_deg: float  # median error
    direction_deg: float  # median error of the direction of translation, NaN without translation
    extract_ms: float  # CPU time of detection and description per image
    match_ms: float  # CPU time of matching per pair
    repeatability: float  # ratio of features that are found again, by depth; NaN without depth


def choose_pairs(usable: Bools, gaps: Sequence[int], wanted: int) -> Iterator[tuple[int, Ints]]:
    """First frames of pairs: for each gap at most `wanted`, evenly spread, perhaps none.

    They lie in the middle of equal parts, as recordings often begin and end without motion.

    `usable`: (N,) frames that may be part of a pair. `gaps`: frames between the images of a pair, 1
    or more each. `wanted`: number of pairs per gap.
    """
    for gap in gaps:
        firsts = np.flatnonzero(usable[:-gap] & usable[gap:])
        count = min(wanted, len(firsts))
        at = ((np.arange(count) + 0.5) * len(firsts) / max(count, 1)).astype(np.int64)
        yield gap, np.asarray(firsts[at], dtype=np.int64)


def score_pair(method: Method, pair: ImagePair, camera: RectifiedRig) -> PairScore:
    """Match a pair and estimate its motion.

    `pair`: the images, rectified as `compare` does it. `camera`: of both, as `rectified_rig` gives
    it for a single camera.
    """
    found = method.match(pair.first, pair.second)
    first, second = camera.undistort(found.first), camera.undistort(found.second)
    usable = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    first, second = first[usable], second[usable]
    inliers, rotation_deg, direction_deg = _motion_errors(pair, first, second, camera.matrix)
    repeated = float("nan")
    if pair.depths is not None:
        transfers = by_depth(pair.depths, pair.second_from_first, camera)
        repeated = repeatability(method.detect(pair.first), method.detect(pair.second), transfers)
    return PairScore(
        found.counts[0],
        len(first),
        _count_correct(pair, first, second, camera.matrix),
        inliers,
        rotation_deg,
        direction_deg,
        found.extract_ms / 2.0,
        found.match_ms,
        repeated,
    )


def summarise(method: str, gap: int, scores: Sequence[PairScore]) -> Comparison:
    """The scores of one method over all pairs of a gap."""
    table = np.array([tuple(score) for score in scores], dtype=np.float64)
    features, matches, correct, inliers = table[:, :4].T
    direction = table[:, 5][np.isfinite(table[:, 5])]
    extract_ms, match_ms = table[:, 6:8].mean(axis=0).tolist()
    repeated = table[:, 8][np.isfinite(table[:, 8])]
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
        float(repeated.mean()) if len(repeated) else float("nan"),
    )


def compare(
    methods: Sequence[Method],
    pairs: Iterable[ImagePair],
    camera: Camera,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Comparison]:
    """Score methods on pairs of images, in one thread; rows are ordered by method, then by gap.

    All methods see a pair before the next one is taken, so that times of a busy machine can be
    compared, and `pairs` may read images when they are needed.

    `methods`: what to compare, of different names. `progress`: called with the name of a method
    before each pair.
    """
    rig = rectified_rig(Rig(camera))
    scores: dict[tuple[str, int], list[PairScore]] = {}
    with one_opencv_thread():
        for number, recorded in enumerate(pairs):
            pair = _rectified(recorded, rig)
            for method in methods:
                if number == 0:
                    method.match(pair.first, pair.first)  # what is loaded at first use
                progress(method.name)
                score = score_pair(method, pair, rig)
                scores.setdefault((method.name, pair.gap), []).append(score)
    order = {method.name: number for number, method in enumerate(methods)}
    keys = sorted(scores, key=lambda key: (order[key[0]], key[1]))
    return [summarise(*key, scores[key]) for key in keys]


def _rectified(pair: ImagePair, rig: RectifiedRig) -> ImagePair:
    """The pair as seen by ideal cameras, if the lens is so wide that images are remapped."""
    if rig.maps[0] is None:
        return pair
    turned = rig.cam0_from_rectified
    depths = pair.depths
    if depths is not None:
        depths = rig.rectify_depth(depths[0]), rig.rectify_depth(depths[1])
    return ImagePair(
        pair.gap,
        rig.rectify(pair.first, 0),
        rig.rectify(pair.second, 0),
        np.asarray(inverse(turned) @ pair.second_from_first @ turned),
        depths,
    )


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
        away = np.linalg.norm(transferred(first, turned) - second, axis=1)
        return int(np.count_nonzero(away <= CORRECT_PX))
    fundamental = epipolar.fundamental_from_motion(truth, matrix)
    errors = np.maximum(*epipolar.epipolar_errors(fundamental, first, second))
    return int(np.count_nonzero(errors <= CORRECT_PX**2))


def _ratio(part: Floats, whole: Floats) -> float:
    total = float(whole.sum())
    return float(part.sum()) / total if total > 0 else 0.0


def true_motion(world_from_first: Floats, world_from_second: Floats) -> Floats:
    """second_from_first (4, 4) of two true poses."""
    return np.asarray(inverse(world_from_second) @ world_from_first)


@dataclass(frozen=True, eq=False)
class PlannedPairs:
    """Pairs to compare methods on; images are read when they are iterated."""

    recording: Recording  # where they are
    world_from_cam: Floats  # (N, 4, 4) true pose of each frame, NaN where it is not known
    frames: tuple[tuple[int, int], ...]  # gap and number of the first frame of each pair

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[ImagePair]:
        """Pairs; those with a frame that cannot be read are left out."""
        for gap, number in self.frames:
            first, second = (self._read(n) for n in (number, number + gap))
            if first is None or second is None or first.image0.shape != second.image0.shape:
                continue
            depths = None
            if first.depth is not None and second.depth is not None:
                depths = first.depth, second.depth
            poses = self.world_from_cam[number], self.world_from_cam[number + gap]
            yield ImagePair(gap, first.image0, second.image0, true_motion(*poses), depths)

    def _read(self, number: int) -> Frame | None:
        return next(iter(list(self.recording.frames(number, number + 1))), None)


def plan_pairs(recording: Recording, gaps: Sequence[int], wanted: int) -> PlannedPairs:
    """Choose at most `wanted` pairs for each gap.

    Raises:
        SourceError: the recording has no ground truth, or no pair of frames has any.
    """
    if recording.ground_truth is None:
        raise SourceError(
            f"{recording.name} has no ground truth, by which methods could be scored; with "
            "`frame=N` they are compared in one image by number, spread and time; vo synth makes "
            "recordings with ground truth"
        )
    poses, known = _poses_of_frames(recording, recording.ground_truth)
    chosen = list(choose_pairs(known, gaps, wanted))
    frames = tuple((gap, int(first)) for gap, firsts in chosen for first in firsts)
    if not frames:
        listed = ", ".join(map(str, gaps))
        raise SourceError(
            f"{recording.name}: no frames with ground truth are {listed} frames apart "
            f"({np.count_nonzero(known)} of {len(recording)} frames have a true pose); give "
            "smaller `gaps`"
        )
    for gap in (gap for gap, firsts in chosen if not len(firsts)):
        _log.warning(
            "gap %d is left out: of %d frames, no two with ground truth are so far apart",
            gap,
            len(recording),
        )
    return PlannedPairs(recording, poses, frames)


def _poses_of_frames(recording: Recording, truth: Trajectory) -> tuple[Floats, Bools]:
    """True poses (N, 4, 4) of all frames, interpolated, and whether they are known (N,)."""
    stamps = recording.stamps_ns
    poses = np.full((len(stamps), 4, 4), np.nan)
    frames = Trajectory(stamps, np.broadcast_to(np.eye(4), poses.shape))
    try:
        matched = associate(frames, truth, interpolated=True)
    except EvaluationError:
        return poses, np.zeros(len(stamps), dtype=bool)
    rows = np.searchsorted(stamps, matched.stamps_ns)
    poses[rows] = matched.reference
    return poses, np.isfinite(poses[:, 0, 0])
