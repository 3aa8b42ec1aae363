"""Calibration of one camera or a pair from observations of a board, without outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.types import Bools, Floats
from vo.tools.calibrating.bundle_adjustment import (
    AdjustmentResult,
    Observation,
    Parameters,
    bundle_adjust,
    rms,
)
from vo.tools.calibrating.initialization import (
    initial_cam1_from_cam0,
    initial_intrinsics,
    initial_pose,
)
from vo.tools.calibrating.projection import LensModel

MIN_VIEWS = 3
_MAX_ROUNDS = 5
_VIEW_GATE = 3.0
"""Outlier limit of a view, in medians of the views' RMS errors."""

_CORNER_GATE = 4.0
"""Outlier limit of a corner, in medians of the corners' errors."""

_MIN_GATE_PX = 0.2
_MIN_CORNERS = 8
_WORTH_MORE_PARAMETERS = 1.02
"""A lens model with more parameters must fit 2 % better."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A calibration and the observations behind it."""

    lenses: tuple[LensModel, ...]
    # The observations used; their views are numbered as the poses
    observations: tuple[Observation, ...]
    frames: tuple[int, ...]  # frame number of each view
    adjustment: AdjustmentResult
    # Frame numbers of outlier views, with their errors in pixels
    dropped: tuple[tuple[int, float], ...] = ()
    dropped_corners: int = 0  # number of single outlier corners


def fit_camera(
    lenses: Sequence[LensModel],
    observations: Sequence[Observation],
    frames: Sequence[int],
    points: Floats,
    size: tuple[int, int],
) -> tuple[Fit, dict[str, float]]:
    """Calibrate one camera with the best of several lens models.

    `lenses`: lens models to compare, those with fewer parameters first. `observations`: one per
    view, of camera 0. `frames`: frame number of each view. `points`: (M, 3) corners on the board.
    `size`: width and height of the images.

    Returns the fit of the first lens model within 2 % of the best, and the RMS errors of all by
    name.

    Raises:
        CalibrationError: too few views, or no camera fits them.
    """
    fits: list[Fit] = []
    for lens in lenses:
        guess = _from_simpler_lens(lens, fits)
        if guess is None:
            guess = initial_intrinsics(lens, observations, points, size)
        fits.append(_fit_lens(lens, guess, observations, frames, points, size))
    # Compare all lens models on the inliers of the best one.
    best = min(fits, key=lambda fit: fit.adjustment.rms_px)
    comparable = [_refit(fit, best, points, size) for fit in fits]
    limit = _WORTH_MORE_PARAMETERS * min(fit.adjustment.rms_px for fit in comparable)
    chosen = next(fit for fit in comparable if fit.adjustment.rms_px <= limit)
    return chosen, {fit.lenses[0].name: fit.adjustment.rms_px for fit in comparable}


def fit_pair(left: Fit, right: Fit, points: Floats) -> Fit:
    """Calibrate two cameras together, starting from the calibration of each.

    Raises:
        CalibrationError: too few views are seen by both cameras.
    """
    frames = sorted({*left.frames, *right.frames})
    poses = [_poses_by_frame(fit) for fit in (left, right)]
    both = [frame for frame in frames if frame in poses[0] and frame in poses[1]]
    if len(both) < MIN_VIEWS:
        raise CalibrationError(
            f"both cameras see the board in only {len(both)} usable frames; at least {MIN_VIEWS} "
            "are needed: hold it where the images overlap, or calibrate one camera: `mode=mono`"
        )
    extrinsics = initial_cam1_from_cam0([(poses[0][frame], poses[1][frame]) for frame in both])
    kept = [frame for frame in frames if frame in poses[0]]
    start = Parameters(
        (left.adjustment.parameters.intrinsics[0], right.adjustment.parameters.intrinsics[0]),
        np.array([poses[0][frame] for frame in kept]),
        extrinsics,
    )
    lenses = (*left.lenses, *right.lenses)
    observations = _merged_observations(left, right, kept)
    fit = Fit(
        lenses,
        observations,
        tuple(kept),
        bundle_adjust(lenses, observations, points, start),
        (*left.dropped, *right.dropped),
        left.dropped_corners + right.dropped_corners,
    )
    return _without_all_outliers(fit, points)


def _merged_observations(left: Fit, right: Fit, frames: Sequence[int]) -> tuple[Observation, ...]:
    """Observations of both cameras in the given frames, with views numbered by frame."""
    number = {frame: i for i, frame in enumerate(frames)}
    return tuple(
        replace(observation, view=number[fit.frames[observation.view]], camera=camera)
        for camera, fit in enumerate((left, right))
        for observation in fit.observations
        if fit.frames[observation.view] in number
    )


def _fit_lens(
    lens: LensModel,
    guess: Floats,
    observations: Sequence[Observation],
    frames: Sequence[int],
    points: Floats,
    size: tuple[int, int],
) -> Fit:
    posed = [(each, initial_pose(lens, guess, each, points, size)) for each in observations]
    usable = [(each, pose) for each, pose in posed if pose is not None]
    if len(usable) < MIN_VIEWS:
        raise CalibrationError(
            f"only {len(usable)} of {len(observations)} views fit a camera with a {lens.name} "
            "lens; check `columns`, `rows` and `model`"
        )
    numbered = tuple(replace(each, view=i, camera=0) for i, (each, _) in enumerate(usable))
    start = Parameters((guess,), np.array([pose for _, pose in usable]))
    adjustment = bundle_adjust([lens], numbered, points, start)
    used = tuple(frames[each.view] for each, _ in usable)
    return _without_all_outliers(Fit((lens,), numbered, used, adjustment), points)


def _refit(fit: Fit, like: Fit, points: Floats, size: tuple[int, int]) -> Fit:
    """The same lens model fitted to the observations of another fit."""
    if fit is like:
        return fit
    lens = fit.lenses[0]
    guess = fit.adjustment.parameters.intrinsics[0]
    poses = _poses_by_frame(fit)
    found = [
        poses[frame] if frame in poses else initial_pose(lens, guess, observation, points, size)
        for frame, observation in zip(like.frames, like.observations, strict=True)
    ]
    if any(pose is None for pose in found):
        return fit
    start = Parameters((guess,), np.array(found))
    adjustment = bundle_adjust([lens], like.observations, points, start)
    return replace(like, lenses=(lens,), adjustment=adjustment)


def _without_all_outliers(fit: Fit, points: Floats) -> Fit:
    """Remove outlier views and corners and adjust again, until there are none."""
    for _ in range(_MAX_ROUNDS):
        inliers = _without_outliers(fit)
        if inliers is fit:
            break
        adjustment = bundle_adjust(
            inliers.lenses, inliers.observations, points, inliers.adjustment.parameters
        )
        fit = replace(inliers, adjustment=adjustment)
    return fit


def _without_outliers(fit: Fit) -> Fit:
    """The fit without outlier views and corners, not adjusted again; itself if there are none."""
    residuals = fit.adjustment.residuals
    errors = np.array([rms([each]) for each in residuals])
    gate = max(_VIEW_GATE * float(np.median(errors)), _MIN_GATE_PX)
    bad = {fit.observations[i].view for i in np.flatnonzero(errors > gate)}
    views = [view for view in range(len(fit.frames)) if view not in bad]
    # Half of the views must be inliers: otherwise the model is wrong, not the views.
    if len(views) < max(MIN_VIEWS, len(fit.frames) // 2):
        return fit
    lengths = [np.linalg.norm(each, axis=1) for each in residuals]
    corner_gate = max(_CORNER_GATE * float(np.median(np.concatenate(lengths))), _MIN_GATE_PX)
    number = {view: i for i, view in enumerate(views)}
    kept = [
        (replace(observation, view=number[observation.view]), length <= corner_gate)
        for observation, length in zip(fit.observations, lengths, strict=True)
        if observation.view not in bad
    ]
    observations = tuple(_with_corners(observation, ok) for observation, ok in kept)
    lost = sum(len(each.ids) for each, _ in kept) - sum(len(each.ids) for each in observations)
    if not bad and not lost:
        return fit
    parameters = fit.adjustment.parameters
    return replace(
        fit,
        observations=observations,
        frames=tuple(fit.frames[view] for view in views),
        adjustment=replace(
            fit.adjustment, parameters=replace(parameters, poses=parameters.poses[views])
        ),
        dropped=(*fit.dropped, *_errors_by_frame(fit, errors, sorted(bad))),
        dropped_corners=fit.dropped_corners + lost,
    )


def _with_corners(observation: Observation, ok: Bools) -> Observation:
    """The observation with some of its corners; with all of them if too few would remain."""
    if ok.sum() < _MIN_CORNERS:
        return observation
    return replace(observation, ids=observation.ids[ok], xy=observation.xy[ok])


def _errors_by_frame(
    fit: Fit, errors: Floats, views: Sequence[int]
) -> tuple[tuple[int, float], ...]:
    """Frame number and error of views, the larger of both cameras."""
    largest = {
        view: max(errors[i] for i, each in enumerate(fit.observations) if each.view == view)
        for view in views
    }
    return tuple((fit.frames[view], float(largest[view])) for view in views)


def _from_simpler_lens(lens: LensModel, fits: Sequence[Fit]) -> Floats | None:
    """Intrinsics fitted with fewer coefficients of the same model; the other coefficients 0."""
    for fit in reversed(fits):
        simpler = fit.lenses[0]
        is_same_model = simpler.distortion_model == lens.distortion_model
        if is_same_model and simpler.coefficients < lens.coefficients:
            values = fit.adjustment.parameters.intrinsics[0]
            return np.concatenate([values, np.zeros(lens.size - simpler.size)])
    return None


def _poses_by_frame(fit: Fit) -> dict[int, Floats]:
    return dict(zip(fit.frames, fit.adjustment.parameters.poses, strict=True))
