"""Motion between two images from an essential or fundamental matrix or a homography of matches."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.transforms import make_transform
from vo.base.types import Bools, Floats
from vo.engine.geometry import epipolar
from vo.engine.geometry.triangulation import in_front, triangulate
from vo.tools.pairs.sampson import line_errors
from vo.tools.pairs.simple_motions import (
    inverse_matrix,
    is_explained,
    plane_of,
    rotation_between,
    rotation_errors,
)
from vo.tools.pairs.two_view_fit import motions_of_essential
from vo.tools.pairs.two_view_records import (
    Fit,
    FitFailure,
    FitFailureReason,
    ModelKind,
    RelativePose,
)
from vo.tools.pairs.two_view_refinement import Motion, refine_motion

_MIN_IN_FRONT = 0.5  # of the inliers
_MIN_RIVAL = 0.9  # of the points in front for the best motion: one with as many may be the true one
_REPROJECTION = 3.0  # maximum error of a triangulated point, in thresholds
_MIN_DECIDING = 8  # matches beside a plane that decide between two motions
_MIN_CONFIRMED = 0.8  # of the inliers, which the motion of a calibrated pair has to explain too
_SAME_MOTION = 0.02  # difference of two motions that are the same


class _Views(NamedTuple):
    """Matched ideal pixels (N, 2) of two images, and their camera matrices (3, 3)."""

    first: Floats
    second: Floats
    matrices: tuple[Floats, Floats]

    def select(self, rows: Bools) -> _Views:
        return _Views(self.first[rows], self.second[rows], self.matrices)

    @property
    def rays(self) -> tuple[Floats, Floats]:
        """(N, 2) normalised image points of both images."""
        one, other = (
            epipolar.transferred(inverse_matrix(matrix), xy)
            for matrix, xy in zip(self.matrices, (self.first, self.second), strict=True)
        )
        return one, other


class _Trial(NamedTuple):
    """A motion, its inliers (n,) in front of both cameras, and how many other matches fit it."""

    motion: Motion
    good: Bools
    angle: Floats
    others: int


def relative_pose(
    fit: Fit,
    first: Floats,
    second: Floats,
    matrices: tuple[Floats, Floats],
    threshold_px: float = 1.5,
) -> RelativePose | FitFailure:
    """The motion that a model of two images means, with points in front of both cameras.

    A model of a plane means up to four motions, of which two usually remain that see the plane from
    one side and in front (Malis and Vargas 2007). Matches beside the plane decide between them; if
    there are none, both are returned.

    `fit`: model of pixels without lens distortion. `first`: (N, 2) ideal pixels of the matches, as
    they were fitted. `second`: (N, 2) the same in the second image. `matrices`: (3, 3) camera
    matrices of both images. `threshold_px`: Sampson distance of matches that fit a motion.
    """
    finite = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    inliers = _Views(first, second, matrices).select(fit.inlier)
    rest = _Views(first, second, matrices).select(finite & ~fit.inlier)
    rotation = rotation_between(inliers.first, inliers.second, matrices)
    errors = rotation_errors(rotation, inliers.first, inliers.second, matrices)
    if is_explained(errors, threshold_px):
        still = rotation_errors(np.eye(3), inliers.first, inliers.second, matrices)
        turn = np.eye(3) if is_explained(still, threshold_px) else rotation
        return RelativePose(make_transform(turn, np.zeros(3)), None, len(errors), 0.0)
    motions = _motions(fit, inliers, threshold_px)
    trials = [_try(motion, inliers, rest, threshold_px) for motion in motions]
    # A homography ties both coordinates of a match, epipolar lines one: its motion is the best one.
    return _choose(trials, inliers, refine=fit.kind is not ModelKind.HOMOGRAPHY)


def calibrated_pose(
    second_from_first: Floats,
    inliers: tuple[Floats, Floats],
    matrices: tuple[Floats, Floats],
    threshold_px: float = 1.5,
) -> RelativePose | None:
    """The motion in metres of a calibrated pair of cameras; None if the matches contradict it.

    `inliers`: (N, 2) ideal pixels of both images that a free model explains.
    """
    views = _Views(*inliers, matrices)
    length_m = float(np.linalg.norm(second_from_first[:3, 3]))
    if length_m == 0.0 or not len(views.first):
        return None
    motion = Motion(second_from_first[:3, :3], second_from_first[:3, 3] / length_m)
    trial = _try(motion, views, views, threshold_px)
    if trial.others < _MIN_CONFIRMED * len(views.first) or not trial.good.any():
        return None
    points, _ = triangulate(second_from_first, *views.rays)
    parallax = float(np.rad2deg(np.median(trial.angle[trial.good])))
    depth_m = float(np.median(points[trial.good, 2]))
    return RelativePose(
        second_from_first, None, int(trial.good.sum()), parallax, is_metric=True, depth_m=depth_m
    )


def _motions(fit: Fit, inliers: _Views, threshold_px: float) -> list[Motion]:
    """Motions that a model may mean, on a plane all that the plane allows."""
    if fit.kind is ModelKind.HOMOGRAPHY:
        return _motions_of_plane(fit.matrix, inliers)
    first, second = inliers.matrices
    is_essential = fit.kind is ModelKind.ESSENTIAL
    essential = fit.matrix if is_essential else second.T @ fit.matrix @ first
    plane = plane_of(inliers.first, inliers.second, threshold_px)
    by_plane = [] if plane is None else _motions_of_plane(plane, inliers)
    return motions_of_essential(essential) + by_plane


def _motions_of_plane(homography: Floats, inliers: _Views) -> list[Motion]:
    """Motions whose plane is seen from one side by all inliers; all if there is no such motion."""
    first, second = inliers.matrices
    of_rays = np.linalg.inv(second) @ homography @ first
    rays = np.column_stack([inliers.rays[0], np.ones(len(inliers.first))])
    moved = rays @ of_rays.T
    # Its sign is that of positive depths in the second image.
    of_rays *= np.sign(np.median(moved[:, 2])) or 1.0
    _, rotations, translations, normals = cv2.decomposeHomographyMat(of_rays, np.eye(3))
    motions, visible = [], []
    for rotation, translation, normal in zip(rotations, translations, normals, strict=True):
        length = float(np.linalg.norm(translation))
        if length < 1e-9:
            continue
        motions.append(Motion(np.asarray(rotation), np.asarray(translation).ravel() / length))
        visible.append(bool((rays @ normal.ravel() > 0).mean() > _MIN_RIVAL))
    kept = [motion for motion, is_seen in zip(motions, visible, strict=True) if is_seen]
    return kept or motions


def _try(motion: Motion, inliers: _Views, rest: _Views, threshold_px: float) -> _Trial:
    transform = make_transform(*motion)
    rays = inliers.rays
    points, angle = triangulate(transform, *rays)
    good = in_front(points, transform)
    moved = points @ motion.rotation.T + motion.translation
    for matrix, ray, at in zip(inliers.matrices, rays, (points, moved), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            error = (at[:, :2] / at[:, 2:] - ray) * np.diag(matrix)[:2]
            good &= np.linalg.norm(error, axis=1) < _REPROJECTION * threshold_px
    inverse_first, inverse_second = (np.linalg.inv(matrix) for matrix in rest.matrices)
    fundamental = inverse_second.T @ motion.essential @ inverse_first
    errors = line_errors(fundamental, rest.first, rest.second)
    return _Trial(motion, good, angle, int((errors <= threshold_px).sum()))


def _choose(trials: list[_Trial], inliers: _Views, *, refine: bool) -> RelativePose | FitFailure:
    """The motion with most points in front, and of several the one that explains most matches."""
    count = len(inliers.first)
    most = max((int(trial.good.sum()) for trial in trials), default=0)
    if most < max(_MIN_IN_FRONT * count, 1):
        return FitFailure(FitFailureReason.NOT_IN_FRONT, most, count)
    likely = [trial for trial in trials if trial.good.sum() > _MIN_RIVAL * most]
    likely.sort(key=lambda trial: (-trial.others, -int(trial.good.sum())))
    best = likely[0]
    motion = _transform(best, inliers, refine=refine)
    alternative = None
    for rival in likely[1:]:
        other = _transform(rival, inliers, refine=refine)
        # Random matches that fit a wrong motion scatter by the root of their number.
        is_decided = best.others - rival.others > _MIN_DECIDING + 3.0 * np.sqrt(rival.others)
        if not is_decided and np.abs(other - motion).max() > _SAME_MOTION:
            alternative = other
            break
    parallax = float(np.rad2deg(np.median(best.angle[best.good])))
    return RelativePose(motion, alternative, int(best.good.sum()), parallax)


def _transform(trial: _Trial, inliers: _Views, *, refine: bool) -> Floats:
    """(4, 4) of a motion, perhaps refined on the points in front."""
    motion = trial.motion
    if refine:
        good = inliers.select(trial.good)
        motion = refine_motion(motion, good.first, good.second, good.matrices)
    return make_transform(*motion)
