"""Two-view reconstruction: motion and points from matches of two images of one camera.

Source: Mur-Artal et al., "ORB-SLAM", 2015, sec. IV (automatic map initialisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.config import StartConfig
from vo.base.failures import Failure, FailureReason
from vo.base.frozen import frozen
from vo.base.geometry.projection import Intrinsics, PixelObservations
from vo.base.geometry.quantiles import median
from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry import epipolar
from vo.engine.geometry.pnp import refine_pose
from vo.engine.geometry.triangulation import in_front, triangulate

# 95 % of the chi-square distribution with 1 and 2 degrees of freedom (Mur-Artal 2015, eq. 2).
_CHI2_LINE, _CHI2_POINT = 3.84, 5.99
# Minimum parallax of a point that is kept, ratio of the parallax that the map needs.
_MIN_PARALLAX_RATIO = 0.3
# Minimum ratio of good points to the most of any motion, for a motion that may be the true one.
_MIN_RIVAL_RATIO = 0.7
# Minimum ratio of squared errors in intermediate views from which the smaller one decides.
_MIN_ERROR_RATIO = 2.0
# Minimum ratio of the score of a motion on all matches to the best one: right ones have 0.99 to 1,
# wrong ones, from a few centimetres of travel and matches off the plane, 0.93 to 0.95.
_MIN_SCORE_RATIO = 0.97
_MIN_COMMON = 30  # points that an intermediate view must share with the two
_MIN_GOOD_RATIO = 0.5  # of good points to inliers


@frozen(eq=False)
class TwoView:
    """A reconstruction from two views.

    Attributes:
        second_from_first: (4, 4); the translation has length 1.
        points: (N, 3) in the first camera's frame, one for each match.
        good: (N,) the matches whose point may be used.
        model: `essential` or `homography`.
    """

    second_from_first: Floats
    points: Floats
    good: Bools
    model: str


class IntermediateView(NamedTuple):
    """Matches as seen by a frame between the two views.

    Attributes:
        rows: (M,) of the matches.
        xy: (M, 2) ideal pixels in this frame.
    """

    rows: Ints
    xy: Floats


class MatchedViews(NamedTuple):
    """Matches of two views of one camera.

    Attributes:
        first: (N, 2) ideal pixels in the first view.
        second: (N, 2) ideal pixels in the second view.
        matrix: (3, 3) camera matrix.
        between: views between the two, oldest first.
    """

    first: Floats
    second: Floats
    matrix: Floats
    between: Sequence[IntermediateView] = ()


def reconstruct(views: MatchedViews, config: StartConfig) -> TwoView | Failure:
    """Motion and points from the matches of two views.

    An essential matrix and a homography are fitted; the one that explains the matches better is
    used (Mur-Artal 2015, sec. IV). Too little parallax (no motion, pure rotation) is a failure,
    whatever the scores.

    Two views of a plane allow two motions (Faugeras and Lustman 1988): one with the true plane and
    one with a plane across the direction of travel. The latter is another plane for every distance
    travelled, so that intermediate views tell them apart.
    """
    first, second, matrix, _ = views
    if len(first) < config.min_matches:
        return Failure(FailureReason.FEW_MATCHES, len(first), config.min_matches)
    if median(np.linalg.norm(second - first, axis=1)) < config.min_motion_px:
        return Failure(FailureReason.LITTLE_MOTION)
    essential = epipolar.find_essential(first, second, matrix, config.threshold_px)
    homography = epipolar.find_homography(first, second, config.threshold_px)
    if essential is None:
        return Failure(FailureReason.NO_ESSENTIAL_MATRIX)
    motion = epipolar.recover_motion(essential[0], first, second, matrix, essential[1])
    line_score = _essential_score(motion, views, config.threshold_px)
    plane_score = 0.0
    if homography is not None:
        plane_score = _homography_score(homography[0], first, second, config.threshold_px)
    # Eq. 5: a plane, or a motion with little parallax, is explained by a homography as well.
    if homography is not None and plane_score > config.homography_ratio * (
        plane_score + line_score
    ):
        candidates = epipolar.motions_of_homography(homography[0], matrix)
        result = _choose(candidates, homography[1], views, config, "homography")
        if isinstance(result, TwoView) and _is_refuted(result, candidates, views, config):
            return Failure(FailureReason.AMBIGUOUS_PLANE)
        if isinstance(result, Failure) and _is_rotation(
            homography[0], views, homography[1], config.threshold_px
        ):
            return Failure(FailureReason.PURE_ROTATION)
        return result
    return _choose([motion], essential[1], views._replace(between=()), config, "essential")


class _Trial(NamedTuple):
    """Points (N, 3) triangulated with a candidate motion, whether good (N,), parallax (N,) rad."""

    points: Floats
    good: Bools
    angle: Floats


def _choose(
    candidates: list[Floats],
    inlier: Bools,
    views: MatchedViews,
    config: StartConfig,
    model: str,
) -> TwoView | Failure:
    """The candidate with clearly the most good points, if it has enough of them and parallax."""
    if not candidates:
        return Failure(FailureReason.PURE_ROTATION)
    trials = [_try(motion, inlier, views, config) for motion in candidates]
    counts = np.array([int(trial.good.sum()) for trial in trials])
    inliers = int(inlier.sum())
    enough = max(config.min_points, _MIN_GOOD_RATIO * inliers)
    best = int(np.argmax(counts))
    rivals = np.flatnonzero(counts > _MIN_RIVAL_RATIO * counts[best])
    if len(rivals) > 1 and counts[best] >= enough:
        errors = [_squared_error(trials[i], views) for i in rivals]
        order = np.argsort(errors)
        if not errors[order[1]] > _MIN_ERROR_RATIO * errors[order[0]]:
            return Failure(FailureReason.AMBIGUOUS_PLANE)
        best = int(rivals[order[0]])
    if counts[best] < enough:
        return Failure(FailureReason.FEW_GOOD_POINTS, int(counts[best]), inliers)
    points, good, angle = trials[best]
    # Far points never show parallax: the parallax of the best `min_points` points is decisive.
    parallax_deg = float(np.rad2deg(np.sort(angle[good])[-config.min_points]))
    if parallax_deg < config.min_parallax_deg:
        return Failure(FailureReason.LITTLE_PARALLAX, parallax_deg, config.min_parallax_deg)
    good &= np.rad2deg(angle) >= _MIN_PARALLAX_RATIO * config.min_parallax_deg
    return TwoView(candidates[best], points, good, model)


def _is_refuted(
    result: TwoView, candidates: list[Floats], views: MatchedViews, config: StartConfig
) -> bool:
    """Whether another motion fits the matches off the plane better."""
    sigma_px = config.threshold_px
    best = max(_essential_score(motion, views, sigma_px) for motion in candidates)
    return _essential_score(result.second_from_first, views, sigma_px) < _MIN_SCORE_RATIO * best


def _is_rotation(
    homography: Floats, views: MatchedViews, inlier: Bools, threshold_px: float
) -> bool:
    """Whether the rotation that is nearest to a homography explains the matches as well."""
    inverse_matrix = np.linalg.inv(views.matrix)
    u, _, vt = np.linalg.svd(inverse_matrix @ homography @ views.matrix)
    by_rotation = views.matrix @ u @ vt @ inverse_matrix
    first, second = views.first[inlier], views.second[inlier]
    turned = cv2.perspectiveTransform(first[None], by_rotation)[0]
    return median(np.linalg.norm(turned - second, axis=1)) < threshold_px


def _try(motion: Floats, inlier: Bools, views: MatchedViews, config: StartConfig) -> _Trial:
    first, second, matrix, _ = views
    focal, centre = np.diag(matrix)[:2], matrix[:2, 2]
    points, angle = triangulate(motion, (first - centre) / focal, (second - centre) / focal)
    good = inlier & in_front(points, motion)
    with np.errstate(divide="ignore", invalid="ignore"):  # points of parallel rays are infinite
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        error_first = points[:, :2] / points[:, 2:] * focal + centre - first
        error_second = moved[:, :2] / moved[:, 2:] * focal + centre - second
        close = np.maximum(np.sum(error_first**2, axis=1), np.sum(error_second**2, axis=1))
    good &= close < _CHI2_POINT * config.threshold_px**2
    return _Trial(points, good, angle)


def _squared_error(trial: _Trial, views: MatchedViews) -> float:
    """Mean over intermediate views of the median squared error, px^2; NaN without views.

    Each view is placed by the points themselves.
    """
    pose, errors = np.eye(4), []
    intrinsics = Intrinsics.from_matrix(views.matrix)
    for view in views.between:
        usable = trial.good[view.rows]
        rows, xy = view.rows[usable], view.xy[usable]
        if len(rows) < _MIN_COMMON:
            continue
        seen = PixelObservations(xy, np.full(len(rows), np.nan), np.ones(len(rows)), 1.0)
        fit = refine_pose(pose, trial.points[rows], seen, intrinsics, 0.0)
        errors.append(median(fit.residual**2))
        pose = fit.cam_from_world  # start of the next view
    return float(np.mean(errors)) if errors else float("nan")


def _essential_score(motion: Floats, views: MatchedViews, sigma_px: float) -> float:
    fundamental = epipolar.fundamental_from_motion(motion, views.matrix)
    errors = epipolar.epipolar_errors(fundamental, views.first, views.second)
    return sum(_score(e / sigma_px**2, _CHI2_LINE) for e in errors)


def _homography_score(homography: Floats, first: Floats, second: Floats, sigma_px: float) -> float:
    errors = epipolar.transfer_errors(homography, first, second)
    return sum(_score(e / sigma_px**2, _CHI2_POINT) for e in errors)


def _score(squared: Floats, limit: float) -> float:
    """Score of squared errors (N,), the same scale for both models (Mur-Artal 2015, eq. 2)."""
    return float(np.sum(np.where(squared < limit, _CHI2_POINT - squared, 0.0)))
