"""The mono start: a first map from two views, or the reason why not yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.config import StartConfig
from vo.geometry import epipolar
from vo.geometry.pnp import refine_pose
from vo.geometry.quantiles import median
from vo.geometry.triangulation import in_front, triangulate
from vo.types import Bools, Floats, Ints

# 95 % of the chi-square distribution with 1 and 2 degrees of freedom (Mur-Artal 2015, eq. 2).
_CHI2_LINE, _CHI2_POINT = 3.84, 5.99
# Points with less than this share of the parallax asked for have no depth worth keeping.
_LEAST_SHARE = 0.3
# Motions that make more than this share of the most good points are rivals: points cannot tell.
_RIVALS = 0.7
# Of rivals the one is taken whose squared errors in the frames between are this much smaller.
_CLEARLY = 2.0
_LEAST_SEEN = 30  # points that a frame between must share with the two


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


class IntermediateView(NamedTuple):
    """What a frame between the two has seen of their matches.

    Attributes:
        rows: (M,) of the matches.
        xy: (M, 2) where they are in it, ideal pixels.
    """

    rows: Ints
    xy: Floats


def start_two_view(
    first: Floats,
    second: Floats,
    matrix: Floats,
    config: StartConfig,
    between: Sequence[IntermediateView] = (),
) -> TwoView | str:
    """Motion and points from matches (N, 2) in ideal pixels, or why there is none.

    Both models are fitted; the one that explains the matches better is used, after
    Mur-Artal et al., "ORB-SLAM", 2015, sec. IV. Too little parallax (standing still, pure
    rotation) gives no map, whatever the scores.

    Two views of a plane allow two motions (Faugeras and Lustman 1988): one with the true plane,
    one with a plane across the direction of travel. The second is another plane for every length
    of the way, so that frames `between`, oldest first, tell them apart.
    """
    if len(first) < config.min_matches:
        return f"{len(first)} matches with the reference frame, {config.min_matches} needed"
    if median(np.linalg.norm(second - first, axis=1)) < config.min_motion_px:
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
        return _choose(
            candidates, homography[1], first, second, matrix, config, "homography", between
        )
    return _choose([motion], essential[1], first, second, matrix, config, "essential")


def _choose(
    candidates: list[Floats],
    inlier: Bools,
    first: Floats,
    second: Floats,
    matrix: Floats,
    config: StartConfig,
    model: str,
    between: Sequence[IntermediateView] = (),
) -> TwoView | str:
    """The candidate with clearly the most good points, if it has enough of them and parallax."""
    if not candidates:
        return "the camera only turns"
    trials = [_trial(motion, inlier, first, second, matrix, config) for motion in candidates]
    counts = np.array([int(good.sum()) for _, good, _ in trials])
    enough = max(config.min_points, 0.5 * int(inlier.sum()))
    best = int(np.argmax(counts))
    rivals = np.flatnonzero(counts > _RIVALS * counts[best])
    if len(rivals) > 1 and counts[best] >= enough:
        errors = [_squared_error(trials[i][0], trials[i][1], between, matrix) for i in rivals]
        order = np.argsort(errors)
        if not errors[order[1]] > _CLEARLY * errors[order[0]]:
            return "the plane in view allows two motions"
        best = int(rivals[order[0]])
    if counts[best] < enough:
        return f"{counts[best]} of {int(inlier.sum())} inliers make good points, too few"
    points, good, angle = trials[best]
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


def _squared_error(
    points: Floats, good: Bools, between: Sequence[IntermediateView], matrix: Floats
) -> float:
    """Of points in the frames between, each placed by them, px^2; mean of medians, NaN if none."""
    pose, errors = np.eye(4), []
    intrinsics = float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])
    for frame in between:
        usable = good[frame.rows]
        rows, xy = frame.rows[usable], frame.xy[usable]
        if len(rows) < _LEAST_SEEN:
            continue
        none, sigma = np.full(len(rows), np.nan), np.ones(len(rows))
        fit = refine_pose(pose, points[rows], xy, none, sigma, 1.0, intrinsics, 0.0)
        errors.append(median(fit.residual**2))
        pose = fit.cam_from_world  # where the next one begins
    return float(np.mean(errors)) if errors else float("nan")


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
