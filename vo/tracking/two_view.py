"""The mono start: a first map from two views, or the reason why not yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.config import StartConfig
from vo.geometry import epipolar
from vo.geometry.triangulation import in_front, triangulate
from vo.types import Bools, Floats

# 95 % of the chi-square distribution with 1 and 2 degrees of freedom (Mur-Artal 2015, eq. 2).
_CHI2_LINE, _CHI2_POINT = 3.84, 5.99
# Points with less than this share of the parallax asked for have no depth worth keeping.
_LEAST_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class TwoView:
    """A first map.

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


def start_two_view(
    first: Floats, second: Floats, matrix: Floats, config: StartConfig
) -> TwoView | str:
    """Motion and points from matches (N, 2) in ideal pixels, or why there is none.

    Both models are fitted; the one that explains the matches better is used, after
    Mur-Artal et al., "ORB-SLAM", 2015, sec. IV. Too little parallax (standing still, pure
    rotation) gives no map, whatever the scores.
    """
    if len(first) < config.min_matches:
        return f"{len(first)} matches with the reference frame, {config.min_matches} needed"
    if float(np.median(np.linalg.norm(second - first, axis=1))) < config.min_motion_px:
        return "the image hardly moves"
    essential = epipolar.find_essential(first, second, matrix, config.threshold_px)
    homography = epipolar.find_homography(first, second, config.threshold_px)
    if essential is None:
        return "no essential matrix fits the matches"
    motion = epipolar.recover_motion(essential[0], first, second, matrix, essential[1])
    line_score = _essential_score(motion, first, second, matrix, config.threshold_px)
    plane_score = 0.0
    if homography is not None:
        plane_score = _homography_score(homography[0], first, second, config.threshold_px)
    # Eq. 5: a plane, or a motion with little parallax, is explained by a homography as well.
    if homography is not None and plane_score > config.homography_share * (
        plane_score + line_score
    ):
        candidates = epipolar.motions_of_homography(homography[0], matrix)
        return _choose(candidates, homography[1], first, second, matrix, config, "homography")
    return _choose([motion], essential[1], first, second, matrix, config, "essential")


def _choose(
    candidates: list[Floats],
    inlier: Bools,
    first: Floats,
    second: Floats,
    matrix: Floats,
    config: StartConfig,
    model: str,
) -> TwoView | str:
    """The candidate with clearly the most good points, if it has enough of them and parallax."""
    if not candidates:
        return "the camera only turns"
    trials = [_trial(motion, inlier, first, second, matrix, config) for motion in candidates]
    counts = [int(good.sum()) for _, good, _ in trials]
    best = int(np.argmax(counts))
    runner_up = max((c for i, c in enumerate(counts) if i != best), default=0)
    points, good, angle = trials[best]
    if counts[best] < max(config.min_points, 0.5 * int(inlier.sum())):
        return f"{counts[best]} of {int(inlier.sum())} inliers make good points, too few"
    if runner_up > 0.7 * counts[best]:
        return "the plane in view allows two motions"
    # Far points never show parallax, however long one waits: enough near ones are what counts.
    parallax = np.rad2deg(np.sort(angle[good])[-config.min_points])
    if parallax < config.min_parallax_deg:
        return f"{parallax:.2f}° of parallax, {config.min_parallax_deg}° needed"
    good &= np.rad2deg(angle) >= _LEAST_SHARE * config.min_parallax_deg
    return TwoView(candidates[best], points, good, model)


def _trial(
    motion: Floats,
    inlier: Bools,
    first: Floats,
    second: Floats,
    matrix: Floats,
    config: StartConfig,
) -> tuple[Floats, Bools, Floats]:
    focal, centre = np.diag(matrix)[:2], matrix[:2, 2]
    points, angle = triangulate(motion, (first - centre) / focal, (second - centre) / focal)
    good = inlier & in_front(points, motion)
    with np.errstate(divide="ignore", invalid="ignore"):  # points of parallel rays are infinite
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        error_first = points[:, :2] / points[:, 2:] * focal + centre - first
        error_second = moved[:, :2] / moved[:, 2:] * focal + centre - second
        close = np.maximum(np.sum(error_first**2, axis=1), np.sum(error_second**2, axis=1))
    good &= close < _CHI2_POINT * config.threshold_px**2
    return points, good, angle


def _essential_score(
    motion: Floats, first: Floats, second: Floats, matrix: Floats, sigma: float
) -> float:
    fundamental = epipolar.fundamental_from_motion(motion, matrix)
    errors = epipolar.epipolar_errors(fundamental, first, second)
    return sum(_score(e / sigma**2, _CHI2_LINE) for e in errors)


def _homography_score(homography: Floats, first: Floats, second: Floats, sigma: float) -> float:
    errors = epipolar.transfer_errors(homography, first, second)
    return sum(_score(e / sigma**2, _CHI2_POINT) for e in errors)


def _score(squared: Floats, limit: float) -> float:
    """Eq. 2 and 3: what an error leaves of the largest allowed one, the same for both models."""
    return float(np.sum(np.where(squared < limit, _CHI2_POINT - squared, 0.0)))
