"""Two images: their features, matches, the geometry between them, and the motion."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np

from vo.base.config import Config
from vo.base.geometry.cameras import ideal_pixels
from vo.base.geometry.transforms import rotation_angle
from vo.base.types import Bools, Bytes, Camera, Floats, Ints, Keypoints
from vo.engine.features.extractor import make_extractor
from vo.engine.features.matching import grid_motion_consistent, make_matcher, method_of
from vo.engine.frontend.contracts import FeatureExtractor, Matches, feature_set
from vo.engine.learned.inference import networks_used
from vo.tools.pairs.model_selection import fit_best
from vo.tools.pairs.relative_pose import calibrated_pose, relative_pose
from vo.tools.pairs.two_view_fit import evidence, fit_essential, fit_fundamental, fit_homography
from vo.tools.pairs.two_view_records import (
    Evidence,
    Fit,
    FitFailure,
    FitFailureReason,
    FitOptions,
    RelativePose,
)

ModelName = Literal["auto", "f", "e", "h"]

# Networks that compare how features lie to each other choose matches that fit together, in
# unrelated images too: only those that are this certain (1 - probability) count against chance.
_GUIDED, _MAX_SCORE, _MIN_CERTAIN = ("lightglue", "lighterglue"), 0.4, 4
# Beyond 75 degrees from the axis a pixel of the lens is many of a pinhole camera.
_MAX_TANGENT = np.tan(np.deg2rad(75.0))


class PairOptions(NamedTuple):
    """How two images are related.

    Attributes:
        grid_motion: keep matches that their neighbours support (GMS) instead of a ratio test.
        model: `f` fundamental, `e` essential (needs cameras), `h` homography, or the one of these
            that explains the matches best.
        cameras: of both images, None if they are unknown.
        baseline: second_from_first (4, 4) in metres of a calibrated pair of cameras; the motion if
            the matches agree with it.
    """

    config: Config
    grid_motion: bool = False
    model: ModelName = "auto"
    fit: FitOptions = FitOptions()
    cameras: tuple[Camera, Camera] | None = None
    baseline: Floats | None = None


@dataclass(frozen=True, eq=False)
class ImagePair:
    """Two images and what relates them.

    Attributes:
        sizes: (width, height) of both images.
        matcher: what found them: a value of `matching.method` other than `auto`, or `gms`.
        fit: the model of the matches; of cameras with a lens, its pixels are those of ideal pinhole
            cameras with the same matrix.
        failure: why there is no model, None if there is one.
        pose: motion from the first to the second camera, None without cameras or model.
        pose_failure: why there is no pose, None if there is one or no cameras are known.
        cameras: of both images, None if they are unknown.
        stage_ms: time of each step in milliseconds.
        baseline_contradicted: a calibrated pair was given, but the matches do not fit its motion.
    """

    sizes: tuple[tuple[int, int], tuple[int, int]]
    keypoints: tuple[Keypoints, Keypoints]
    matches: Matches
    matcher: str
    fit: Fit | None
    failure: FitFailure | None
    pose: RelativePose | None
    pose_failure: FitFailure | None
    cameras: tuple[Camera, Camera] | None
    stage_ms: dict[str, float]
    baseline_contradicted: bool = False

    @property
    def first_xy(self) -> Floats:
        """(n, 2) pixels of the matches in the first image."""
        return np.asarray(self.keypoints[0].xy[self.matches.query], dtype=np.float64)

    @property
    def second_xy(self) -> Floats:
        """(n, 2) pixels of the matches in the second image."""
        return np.asarray(self.keypoints[1].xy[self.matches.train], dtype=np.float64)

    @property
    def matched_rows(self) -> Ints:
        """(n, 2) rows of the matched keypoints in both images."""
        return np.column_stack([self.matches.query, self.matches.train])

    @property
    def inlier(self) -> Bools:
        """(n,) matches that the model explains."""
        return np.zeros(len(self.matches.query), bool) if self.fit is None else self.fit.inlier


def match_images(
    images: tuple[Bytes, Bytes],
    options: PairOptions,
    masks: tuple[Bytes | None, Bytes | None] = (None, None),
) -> ImagePair:
    """Relate two images.

    Args:
        images: (H, W) uint8 each, perhaps of different size.
        options: how.
        masks: (H, W) uint8 for each, 0 where no feature may lie.

    Raises:
        ConfigError: this build of OpenCV lacks a detector, descriptor or matcher.
    """
    matcher = PairMatcher(options)
    first, second = (
        matcher.extract(image, mask) for image, mask in zip(images, masks, strict=True)
    )
    return matcher.match(first, second)


class ImageFeatures(NamedTuple):
    """The features of one image."""

    keypoints: Keypoints
    size: tuple[int, int]  # width, height
    ms: float  # that finding them took


class PairMatcher:
    """Finds the features of images once, and matches any two of them."""

    def __init__(self, options: PairOptions) -> None:
        self._options = options
        with networks_used(options.config.features.device):
            self._extractor = make_extractor(options.config.features)

    def extract(self, image: Bytes, mask: Bytes | None = None) -> ImageFeatures:
        """Features of an image (H, W) uint8, outside of where its mask is 0."""
        watch = _Watch()
        with watch("features"):
            found = self._extractor.extract(image, mask)
        return ImageFeatures(found, (image.shape[1], image.shape[0]), watch.ms["features"])

    def match(self, first: ImageFeatures, second: ImageFeatures) -> ImagePair:
        """What relates two images."""
        options, watch = self._options, _Watch()
        watch.ms["features"] = first.ms + second.ms
        keypoints, sizes = (first.keypoints, second.keypoints), (first.size, second.size)
        with watch("matching"):
            matches = _matches(self._extractor, keypoints, sizes, options)
        method = method_of(options.config.matching, self._extractor)
        matcher = "gms" if options.grid_motion else method
        nothing = (None, None, None, None)
        pair = ImagePair(sizes, keypoints, matches, matcher, *nothing, options.cameras, watch.ms)
        with watch("geometry"):
            return _with_geometry(pair, options)


class _Watch:
    """Measures steps."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        begin = perf_counter()
        try:
            yield
        finally:
            self.ms[name] = 1e3 * (perf_counter() - begin)


def _matches(
    extractor: FeatureExtractor,
    keypoints: tuple[Keypoints, Keypoints],
    sizes: tuple[tuple[int, int], tuple[int, int]],
    options: PairOptions,
) -> Matches:
    config = options.config
    matcher = make_matcher(config.matching, extractor, config.features)
    query, train = (
        feature_set(each, size=size) for each, size in zip(keypoints, sizes, strict=True)
    )
    if not options.grid_motion:
        return matcher.match(query, train)
    every = matcher.match(query, train, ratio=1.0, check_rotation=False)
    return grid_motion_consistent(every, keypoints[0].xy, keypoints[1].xy, sizes)


def _ideal(camera: Camera, pixels: Floats) -> Floats:
    """Ideal pixels (N, 2); NaN, and so left out, where a wide lens would stretch them too far."""
    ideal = ideal_pixels(camera, pixels)
    rays = (ideal - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    with np.errstate(invalid="ignore"):
        far = np.hypot(rays[:, 0], rays[:, 1]) > _MAX_TANGENT
    ideal[far] = np.nan
    return ideal


def _with_geometry(pair: ImagePair, options: PairOptions) -> ImagePair:
    first, second, cameras = pair.first_xy, pair.second_xy, pair.cameras
    matrices = None
    if cameras is not None:
        matrices = (cameras[0].matrix, cameras[1].matrix)
        first, second = (_ideal(*each) for each in zip(cameras, (first, second), strict=True))
    quality = pair.matches.score
    if options.model == "auto":
        found = fit_best(first, second, matrices, options.fit, quality)
    elif options.model == "e":
        assert matrices is not None, "an essential matrix needs cameras"
        found = fit_essential(first, second, matrices, options.fit, quality)
    else:
        function = fit_fundamental if options.model == "f" else fit_homography
        found = function(first, second, options.fit, quality)
    if isinstance(found, Fit) and pair.matcher in _GUIDED:
        found = _by_certain(found, first, second, quality < _MAX_SCORE, options.fit.threshold_px)
    if isinstance(found, FitFailure):
        return replace(pair, failure=found)
    if matrices is None:
        return replace(pair, fit=found)
    if options.baseline is not None:
        inliers = first[found.inlier], second[found.inlier]
        known = calibrated_pose(options.baseline, inliers, matrices, options.fit.threshold_px)
        if known is not None:
            return replace(pair, fit=found, pose=known)
        pair = replace(pair, baseline_contradicted=True)
    pose = relative_pose(found, first, second, matrices, options.fit.threshold_px)
    if isinstance(pose, FitFailure):
        return replace(pair, fit=found, pose_failure=pose)
    return replace(pair, fit=found, pose=pose)


def _by_certain(
    fit: Fit, first: Floats, second: Floats, certain: Bools, threshold_px: float
) -> Fit | FitFailure:
    """The fit, unless its certain matches are no more than chance would give."""
    rows = np.flatnonzero(certain & np.isfinite(fit.error_px))
    inlier = fit.inlier[rows]
    counted = Evidence(int(inlier.sum()), len(rows), fit.evidence.needed)
    if len(rows) >= _MIN_CERTAIN:
        counted = evidence(fit.kind, first[rows], second[rows], inlier, threshold_px)
    fit = replace(fit, evidence=counted)
    if counted.is_enough:
        return fit
    numbers = (counted.inliers, counted.needed, counted.matches)
    return FitFailure(FitFailureReason.NO_CONSENSUS, *numbers, fit)


def pair_record(pair: ImagePair, options: PairOptions, names: tuple[str, str]) -> dict[str, Any]:
    """The record that `vo match --json` prints (docs/features.md)."""
    features, matching = options.config.features, options.config.matching
    return {
        "images": [
            {"name": name, "width": size[0], "height": size[1], "keypoints": len(keypoints)}
            for name, size, keypoints in zip(names, pair.sizes, pair.keypoints, strict=True)
        ],
        "detector": features.detector,
        "descriptor": features.descriptor,
        "matcher": "gms" if options.grid_motion else matching.method,
        "matches": len(pair.matches.query),
        "inliers": int(pair.inlier.sum()),
        "model": None if pair.fit is None else _model(pair.fit),
        "failure": None if pair.failure is None else pair.failure.text,
        "failure_reason": None if pair.failure is None else pair.failure.reason.name.lower(),
        "chance": _chance(pair),
        "pose": None if pair.pose is None else _pose(pair.pose),
        "pose_failure": None if pair.pose_failure is None else pair.pose_failure.text,
        "ms": {step: round(ms, 3) for step, ms in pair.stage_ms.items()},
    }


def keypoint_record(pair: ImagePair) -> dict[str, Any]:
    """What `--keypoints` adds: pixels of both images, rows of the matches in them, inliers."""
    return {
        "keypoints_px": [np.round(each.xy, 3).tolist() for each in pair.keypoints],
        "matched_keypoints": pair.matched_rows.tolist(),
        "is_inlier": pair.inlier.tolist(),
    }


def _chance(pair: ImagePair) -> dict[str, int] | None:
    fit = pair.fit if pair.failure is None else pair.failure.refused
    return None if fit is None else fit.evidence._asdict()


def _model(fit: Fit) -> dict[str, Any]:
    return {
        "kind": fit.kind.value,
        "method": fit.method,
        "matrix": fit.matrix.tolist(),
        "symmetric_error_px": fit.symmetric_px,
        "sampson_error_px": float(np.median(fit.error_px[fit.inlier])),
    }


def _pose(pose: RelativePose) -> dict[str, Any]:
    motion = pose.second_from_first
    return {
        "second_from_first": motion.tolist(),
        "has_translation": pose.has_translation,
        "rotation_deg": float(np.rad2deg(rotation_angle(motion[:3, :3]))),
        "alternative": None if pose.alternative is None else pose.alternative.tolist(),
        "in_front": pose.in_front,
        "parallax_deg": pose.parallax_deg,
        "is_metric": pose.is_metric,
        "depth_m": pose.depth_m,
    }
