"""Fundamental matrix, essential matrix and homography of matches, many of which may be wrong.

OpenCV finds a first model; here it is refined on its inliers, and these are chosen again, by the
same measure for all methods. OpenCV 5.0 gives no result for a camera matrix that is not contiguous,
raises errors on degenerate points, stacks several solutions of a minimal set, and its PROSAC
believes that the first matches are the best; so matches are checked, copied and ordered before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry import epipolar
from vo.tools.pairs.sampson import line_errors, point_errors
from vo.tools.pairs.simple_motions import (
    inverse_matrix,
    is_explained,
    plane_of,
    rotation_between,
    rotation_errors,
)
from vo.tools.pairs.two_view_records import (
    Evidence,
    Fit,
    FitFailure,
    FitFailureReason,
    FitOptions,
    ModelKind,
)
from vo.tools.pairs.two_view_refinement import (
    Motion,
    refine_fundamental,
    refine_homography,
    refine_motion,
)

_METHODS = {
    "ransac": cv2.RANSAC,
    "lmeds": cv2.LMEDS,
    "usac_default": cv2.USAC_DEFAULT,
    "usac_fast": cv2.USAC_FAST,
    "usac_accurate": cv2.USAC_ACCURATE,
    "magsac": cv2.USAC_MAGSAC,
    "prosac": cv2.USAC_PROSAC,
}
_MAX_ITERATIONS = 10000
_ROUNDS = 3  # of refinement and choice of the inliers
_NOISE = (
    4.0  # maximum error in medians of those of the inliers: 2.7 sigma of a distance from a line
)
_ROUNDING_PX = 1e-9
_MIN_WIDTH = 0.5  # of the scatter across a line, in thresholds; with less, points are on the line


class _Model(NamedTuple):
    """How a kind of model is found."""

    kind: ModelKind
    sample: int
    needed: int
    # OpenCV's function; its results, (3, 3) or stacked ones, for some points
    find: Callable[[Floats, Floats], Any]
    # Improves it by matches, all of which are right
    refine: Callable[[Floats, Floats, Floats], Floats]
    in_pixels: Callable[[Floats], Floats] = np.asarray  # the same matrix for pixels

    def errors(self, matrix: Floats, first: Floats, second: Floats) -> Floats:
        """Sampson distances (N,) of pixels (N, 2) in px."""
        measure = point_errors if self.kind is ModelKind.HOMOGRAPHY else line_errors
        return measure(self.in_pixels(matrix), first, second)

    def symmetric_px(self, matrix: Floats, first: Floats, second: Floats) -> float:
        """Median over the matches of the root mean square of the distances in both images.

        Not a mean, as a distance from an epipolar line is arbitrary near the epipole.
        """
        is_plane = self.kind is ModelKind.HOMOGRAPHY
        measure = epipolar.transfer_errors if is_plane else epipolar.epipolar_errors
        squared = measure(self.in_pixels(matrix), first, second)
        return float(np.median(np.sqrt(np.mean(squared, axis=0))))


def fit_fundamental(
    first: Floats,
    second: Floats,
    options: FitOptions = FitOptions(),  # noqa: B008 - immutable
    quality: Floats | None = None,
) -> Fit | FitFailure:
    """Fundamental matrix of matched pixels.

    `first`: (N, 2) pixels without lens distortion; rows with NaN are left out. `second`: (N, 2) the
    same in the second image. `quality`: (N,) lower is better, such as the distances of the
    descriptors, for PROSAC.
    """

    def find(a: Floats, b: Floats) -> Any:
        return cv2.findFundamentalMat(
            a,
            b,
            _METHODS[options.method],
            options.threshold_px,
            options.confidence,
            _MAX_ITERATIONS,
        )[0]

    model = _Model(ModelKind.FUNDAMENTAL, 7, 8, find, refine_fundamental)
    fit = _fit(model, first, second, options, quality)
    if isinstance(fit, FitFailure):
        return fit
    a, b = first[fit.inlier], second[fit.inlier]
    if float(np.median(np.linalg.norm(b - a, axis=1))) < options.threshold_px:
        return FitFailure(FitFailureReason.NO_MOTION)
    if plane_of(a, b, options.threshold_px) is not None:
        return FitFailure(FitFailureReason.PLANE_OR_ROTATION)
    return fit


def fit_essential(
    first: Floats,
    second: Floats,
    matrices: tuple[Floats, Floats],
    options: FitOptions = FitOptions(),  # noqa: B008 - immutable
    quality: Floats | None = None,
) -> Fit | FitFailure:
    """Essential matrix of matched pixels of calibrated cameras.

    Source: Nister, "An efficient solution to the five-point relative pose problem", PAMI 2004.

    `first`: (N, 2) ideal pixels (`vo.base.geometry.cameras.ideal_pixels`); rows with NaN are left
    out. `second`: (N, 2) the same in the second image. `matrices`: (3, 3) camera matrices of both
    images. `quality`: (N,) lower is better, such as the distances of the descriptors, for PROSAC.
    """
    inverse_first, inverse_second = (inverse_matrix(matrix) for matrix in matrices)
    focal_px = float(np.mean([np.diag(matrix)[:2] for matrix in matrices]))

    def find(a: Floats, b: Floats) -> Any:
        rays_first = np.ascontiguousarray(epipolar.transferred(inverse_first, a))
        rays_second = np.ascontiguousarray(epipolar.transferred(inverse_second, b))
        method, threshold = _METHODS[options.method], options.threshold_px / focal_px
        return cv2.findEssentialMat(
            rays_first,
            rays_second,
            np.eye(3),
            method,
            options.confidence,
            threshold,
            _MAX_ITERATIONS,
        )[0]

    def in_pixels(essential: Floats) -> Floats:
        return np.asarray(inverse_second.T @ essential @ inverse_first)

    def refine(essential: Floats, a: Floats, b: Floats) -> Floats:
        motion = refine_motion(motions_of_essential(essential)[0], a, b, matrices)
        return np.asarray(motion.essential / np.sqrt(2.0))

    model = _Model(ModelKind.ESSENTIAL, 5, 6, find, refine, in_pixels)
    fit = _fit(model, first, second, options, quality)
    if isinstance(fit, FitFailure):
        return fit
    a, b = first[fit.inlier], second[fit.inlier]
    rotation = rotation_between(a, b, matrices)
    if not is_explained(rotation_errors(rotation, a, b, matrices), options.threshold_px):
        return fit
    still = rotation_errors(np.eye(3), a, b, matrices)
    is_still = is_explained(still, options.threshold_px)
    return FitFailure(FitFailureReason.NO_MOTION if is_still else FitFailureReason.PURE_ROTATION)


def fit_homography(
    first: Floats,
    second: Floats,
    options: FitOptions = FitOptions(),  # noqa: B008 - immutable
    quality: Floats | None = None,
) -> Fit | FitFailure:
    """Homography of matched pixels.

    `first`: (N, 2) pixels without lens distortion; rows with NaN are left out. `second`: (N, 2) the
    same in the second image. `quality`: (N,) lower is better, such as the distances of the
    descriptors, for PROSAC.
    """

    def find(a: Floats, b: Floats) -> Any:
        return cv2.findHomography(
            a,
            b,
            _METHODS[options.method],
            options.threshold_px,
            maxIters=_MAX_ITERATIONS,
            confidence=options.confidence,
        )[0]

    model = _Model(ModelKind.HOMOGRAPHY, 4, 4, find, refine_homography)
    return _fit(model, first, second, options, quality)


def motions_of_essential(essential: Floats) -> list[Motion]:
    """The four motions of an essential matrix (Hartley and Zisserman, section 9.6.2)."""
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.linalg.det(u), vt * np.linalg.det(vt)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotations = [u @ each @ vt for each in (turn, turn.T)]
    return [Motion(rotation, sign * u[:, 2]) for rotation in rotations for sign in (1.0, -1.0)]


def _fit(
    model: _Model, first: Floats, second: Floats, options: FitOptions, quality: Floats | None
) -> Fit | FitFailure:
    first, second = (np.asarray(xy, dtype=np.float64).reshape(-1, 2) for xy in (first, second))
    rows = _order(first, second, options, quality)
    failure = _too_few(model, first[rows], second[rows], options.threshold_px)
    if failure is not None:
        return failure
    a, b = np.ascontiguousarray(first[rows]), np.ascontiguousarray(second[rows])
    matrix = _first_model(model, a, b, options.threshold_px)
    error_px = np.full(len(first), np.nan)
    if matrix is not None:
        matrix = _refined(model, matrix, a, b, options.threshold_px)
        error_px[rows] = model.errors(matrix, a, b)
    inlier = error_px <= options.threshold_px
    found = evidence(model.kind, a, b, inlier[rows], options.threshold_px)
    failure = FitFailure(FitFailureReason.NO_CONSENSUS, found.inliers, found.needed, found.matches)
    if matrix is None or int(inlier.sum()) < model.needed:
        return failure
    if any(_is_on_a_line(xy[inlier], options.threshold_px) for xy in (first, second)):
        return FitFailure(FitFailureReason.ON_A_LINE)
    symmetric_px = model.symmetric_px(matrix, first[inlier], second[inlier])
    fit = Fit(model.kind, matrix, inlier, error_px, symmetric_px, options.method, found)
    return fit if found.is_enough else failure._replace(refused=fit)


def _order(first: Floats, second: Floats, options: FitOptions, quality: Floats | None) -> Ints:
    """Rows of matches without NaN: the best first for PROSAC, else in random order."""
    finite = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    rows = np.flatnonzero(finite)
    rows = rows[np.random.default_rng(options.seed).permutation(len(rows))]
    if options.method == "prosac" and quality is not None:
        rows = rows[np.argsort(np.asarray(quality)[rows], kind="stable")]
    return rows


def _too_few(
    model: _Model, first: Floats, second: Floats, threshold_px: float
) -> FitFailure | None:
    if len(first) < model.needed:
        return FitFailure(FitFailureReason.FEW_MATCHES, len(first), model.needed)
    for xy in (first, second):
        places = len(np.unique(xy, axis=0))
        if places < model.needed:
            return FitFailure(FitFailureReason.FEW_PLACES, places, model.needed)
        if _is_on_a_line(xy, threshold_px):
            return FitFailure(FitFailureReason.ON_A_LINE)
    return None


def _is_on_a_line(xy: Floats, threshold_px: float) -> bool:
    across = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)[-1]
    return bool(across / np.sqrt(len(xy)) < _MIN_WIDTH * threshold_px)


def _first_model(
    model: _Model, first: Floats, second: Floats, threshold_px: float
) -> Floats | None:
    """OpenCV's model, of several the one that fits best; None without one."""
    try:
        found = model.find(first, second)
    except cv2.error:  # degenerate points
        return None
    if found is None or found.size % 9 != 0 or not np.isfinite(found).all():
        return None
    costs = []
    matrices = [each for each in np.asarray(found, np.float64).reshape(-1, 3, 3) if each.any()]
    for matrix in matrices:
        costs.append(float(np.minimum(model.errors(matrix, first, second), threshold_px).sum()))
    return matrices[int(np.argmin(costs))] if matrices else None


def _refined(
    model: _Model, matrix: Floats, first: Floats, second: Floats, threshold_px: float
) -> Floats:
    """The model refined on its inliers; of all rounds, the one with the lowest truncated errors.

    The last rounds leave out what only chance brought within the threshold: matches far beyond the
    noise of the others.
    """

    def cost(matrix: Floats) -> float:
        errors = np.minimum(model.errors(matrix, first, second), threshold_px)
        return float((errors**2).sum())

    best, lowest = matrix, cost(matrix)
    for factor in (2.0, *[1.0] * _ROUNDS):
        inlier = model.errors(matrix, first, second) <= factor * threshold_px
        if int(inlier.sum()) < model.needed:
            break
        matrix = model.refine(matrix, first[inlier], second[inlier])
        if not np.isfinite(matrix).all():
            break
        trial = cost(matrix)
        if trial < lowest:
            best, lowest = matrix, trial
    for _ in range(_ROUNDS):
        errors = model.errors(best, first, second)
        inlier = errors <= threshold_px
        if not inlier.any():
            break
        inlier &= errors <= _NOISE * np.median(errors[inlier]) + _ROUNDING_PX
        if int(inlier.sum()) < model.needed:
            break
        matrix = model.refine(best, first[inlier], second[inlier])
        if not np.isfinite(matrix).all():
            break
        best = matrix
    # The usual scale of a homography, where no pixel at the origin goes to infinity.
    is_plane = model.kind is ModelKind.HOMOGRAPHY and abs(best[2, 2]) > 1e-9 * abs(best).max()
    return np.asarray(best / (best[2, 2] if is_plane else np.linalg.norm(best)))


_SAMPLE = {ModelKind.FUNDAMENTAL: 7, ModelKind.ESSENTIAL: 5, ModelKind.HOMOGRAPHY: 4}
_MAX_LOG10_FALSE_ALARMS = -3.0  # one in a thousand pairs
_SAME_PLACE = 0.006  # of the diagonal of the spread: features so near show the same thing
_MIN_SAME_PLACE_PX = 3.0
_MAX_HIT_RATIO = 0.5


def evidence(
    kind: ModelKind, first: Floats, second: Floats, inlier: Bools, threshold_px: float
) -> Evidence:
    """Compare the inliers of a model with those of random matches of the same spread.

    Features at one place (several orientations of one corner, neighbours in one patch) are matched
    to one place by the same mistake, so they count once. The inliers' own spread is what a random
    match would have to hit: learned matchers put wrong matches close together, too.
    """
    radius = [_same_place(xy) for xy in (first, second)]
    order = np.argsort(~inlier, kind="stable")
    kept = order[_separate(first[order], second[order], radius)]
    inliers, matches = int(inlier[kept].sum()), len(kept)
    spread = inlier if inliers > _SAMPLE[kind] else np.ones(len(inlier), dtype=bool)
    hit_ratio = max(_hit_ratio(kind, xy[spread], threshold_px) for xy in (first, second))
    needed = _SAMPLE[kind] + 1
    while _log10_false_alarms(kind, matches, needed, hit_ratio) > _MAX_LOG10_FALSE_ALARMS:
        needed += 1
    return Evidence(inliers, matches, needed)


def _same_place(xy: Floats) -> float:
    return max(_MIN_SAME_PLACE_PX, _SAME_PLACE * float(np.hypot(*np.ptp(xy, axis=0))))


def _separate(first: Floats, second: Floats, radius: list[float]) -> list[int]:
    """Rows of which no two are near each other in either image; earlier ones are preferred."""
    free = np.ones(len(first), dtype=bool)
    kept = []
    for row in range(len(first)):
        if free[row]:
            kept.append(row)
            for xy, near in zip((first, second), radius, strict=True):
                free &= ((xy - xy[row]) ** 2).sum(axis=1) > near**2
    return kept


def _hit_ratio(kind: ModelKind, xy: Floats, threshold_px: float) -> float:
    """Ratio of the area that points cover, as a uniform density, within reach of a model."""
    variances = np.maximum(np.linalg.eigvalsh(np.cov(xy.T)), 1e-12)
    length, width = np.sqrt(12.0 * variances[::-1])
    reach = math.sqrt(2.0) * threshold_px  # a Sampson distance is shared by two images
    covered = math.pi * reach**2 if kind is ModelKind.HOMOGRAPHY else 2.0 * reach * length
    return min(float(covered / (length * width)), _MAX_HIT_RATIO)


def _log10_false_alarms(kind: ModelKind, matches: int, inliers: int, hit_ratio: float) -> float:
    """Expected number of models of random matches, of all samples, with as many inliers."""
    sample, total = _SAMPLE[kind], max(matches, inliers)
    samples = math.log(total - sample)
    samples += _log_choices(total, inliers) + _log_choices(inliers, sample)
    return (samples + (inliers - sample) * math.log(hit_ratio)) / math.log(10.0)


def _log_choices(total: int, chosen: int) -> float:
    return math.lgamma(total + 1) - math.lgamma(chosen + 1) - math.lgamma(total - chosen + 1)
