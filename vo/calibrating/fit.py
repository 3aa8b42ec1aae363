"""One camera or two from views of a board, without the views and corners that do not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.calibrating.adjustment import Adjusted, Sight, Unknowns, adjust, rms
from vo.calibrating.projection import Lens
from vo.calibrating.start import first_cam1_from_cam0, first_intrinsics, first_pose
from vo.errors import CalibrationError
from vo.types import Floats

FEWEST_VIEWS = 3
_ROUNDS = 5
_VIEW_GATE = 3.0
_CORNER_GATE = 4.0
_LEAST_GATE_PX = 0.2
_FEWEST_CORNERS = 8
_WORTH_MORE_UNKNOWNS = 1.02
"""A lens with more unknowns must be better by 2 %."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A calibration and what it rests on.

    Attributes:
        lenses: of each camera.
        sights: what was used; their views are numbered as the poses.
        frames: number of the frame of each view.
        adjusted: the result.
        dropped: numbers of the frames whose view did not fit, with the error in pixels.
        dropped_corners: how many single corners did not fit.
    """

    lenses: tuple[Lens, ...]
    sights: tuple[Sight, ...]
    frames: tuple[int, ...]
    adjusted: Adjusted
    dropped: tuple[tuple[int, float], ...] = ()
    dropped_corners: int = 0


def fit_camera(
    lenses: Sequence[Lens],
    sights: Sequence[Sight],
    frames: Sequence[int],
    points: Floats,
    size: tuple[int, int],
) -> tuple[Fit, dict[str, float]]:
    """Calibrate one camera with the best of some lenses.

    Args:
        lenses: to compare, those with fewer unknowns first.
        sights: a view each, of camera 0.
        frames: number of the frame of each view.
        points: (M, 3) corners on the board.
        size: width and height of the images.

    Returns:
        The fit with the first lens that is within 2 % of the best, and the RMS of all.

    Raises:
        CalibrationError: too few views, or they fit no camera.
    """
    fits: list[Fit] = []
    for lens in lenses:
        guess = _from_simpler(lens, fits)
        if guess is None:
            guess = first_intrinsics(lens, sights, points, size)
        fits.append(_fit_lens(lens, guess, sights, frames, points, size))
    # Compared on all views and corners but those that the best lens does not explain either.
    best = min(fits, key=lambda fit: fit.adjusted.rms_px)
    again = [_refit(fit, best, points, size) for fit in fits]
    limit = _WORTH_MORE_UNKNOWNS * min(fit.adjusted.rms_px for fit in again)
    chosen = next(fit for fit in again if fit.adjusted.rms_px <= limit)
    return chosen, {fit.lenses[0].name: fit.adjusted.rms_px for fit in again}


def fit_pair(left: Fit, right: Fit, points: Floats, size: tuple[int, int]) -> Fit:
    """Calibrate two cameras together, from what each was calibrated with.

    Raises:
        CalibrationError: no view is seen by both.
    """
    frames = sorted({*left.frames, *right.frames})
    poses = [_poses_by_frame(fit) for fit in (left, right)]
    both = [frame for frame in frames if frame in poses[0] and frame in poses[1]]
    if len(both) < FEWEST_VIEWS:
        raise CalibrationError(
            f"both cameras see the board in {len(both)} of the frames that fit; {FEWEST_VIEWS} at "
            "least are needed: hold it where the images overlap (one camera alone: --mode mono)"
        )
    extrinsics = first_cam1_from_cam0([(poses[0][frame], poses[1][frame]) for frame in both])
    kept = [frame for frame in frames if frame in poses[0]]
    number = {frame: i for i, frame in enumerate(kept)}
    sights = [
        replace(sight, view=number[fit.frames[sight.view]], camera=camera)
        for camera, fit in enumerate((left, right))
        for sight in fit.sights
        if fit.frames[sight.view] in number
    ]
    start = Unknowns(
        (left.adjusted.unknowns.intrinsics[0], right.adjusted.unknowns.intrinsics[0]),
        np.array([poses[0][frame] for frame in kept]),
        extrinsics,
    )
    fit = Fit(
        (*left.lenses, *right.lenses),
        tuple(sights),
        tuple(kept),
        adjust((*left.lenses, *right.lenses), sights, points, start),
        (*left.dropped, *right.dropped),
        left.dropped_corners + right.dropped_corners,
    )
    return _cleaned(fit, points)


def _fit_lens(
    lens: Lens,
    guess: Floats,
    sights: Sequence[Sight],
    frames: Sequence[int],
    points: Floats,
    size: tuple[int, int],
) -> Fit:
    posed = [(sight, first_pose(lens, guess, sight, points, size)) for sight in sights]
    usable = [(sight, pose) for sight, pose in posed if pose is not None]
    if len(usable) < FEWEST_VIEWS:
        raise CalibrationError(
            f"only {len(usable)} of {len(sights)} views fit a camera with a {lens.name} lens; "
            "check --columns, --rows and --model"
        )
    numbered = tuple(replace(sight, view=i, camera=0) for i, (sight, _) in enumerate(usable))
    start = Unknowns((guess,), np.array([pose for _, pose in usable]))
    adjusted = adjust([lens], numbered, points, start)
    used = tuple(frames[sight.view] for sight, _ in usable)
    return _cleaned(Fit((lens,), numbered, used, adjusted), points)


def _refit(fit: Fit, like: Fit, points: Floats, size: tuple[int, int]) -> Fit:
    """With the very corners of another fit."""
    if fit is like:
        return fit
    lens = fit.lenses[0]
    guess = fit.adjusted.unknowns.intrinsics[0]
    poses = _poses_by_frame(fit)
    found = [
        poses[frame] if frame in poses else first_pose(lens, guess, sight, points, size)
        for frame, sight in zip(like.frames, like.sights, strict=True)
    ]
    if any(pose is None for pose in found):
        return fit
    adjusted = adjust([lens], like.sights, points, Unknowns((guess,), np.array(found)))
    return replace(like, lenses=(lens,), adjusted=adjusted)


def _cleaned(fit: Fit, points: Floats) -> Fit:
    """Without views and corners that do not fit, adjusted again, until all that is left fits."""
    for _ in range(_ROUNDS):
        smaller = _without_outliers(fit)
        if smaller is fit:
            break
        adjusted = adjust(smaller.lenses, smaller.sights, points, smaller.adjusted.unknowns)
        fit = replace(smaller, adjusted=adjusted)
    return fit


def _without_outliers(fit: Fit) -> Fit:
    residuals = fit.adjusted.residuals
    lengths = [np.linalg.norm(each, axis=1) for each in residuals]
    typical = float(np.median(np.concatenate(lengths)))
    errors = np.array([rms([each]) for each in residuals])
    gate = max(_VIEW_GATE * float(np.median(errors)), _LEAST_GATE_PX)
    # Half of the views must stay: if more do not fit, it is the model that is wrong.
    bad = {fit.sights[i].view for i in np.flatnonzero(errors > gate)}
    views = [view for view in range(len(fit.frames)) if view not in bad]
    if len(views) < max(FEWEST_VIEWS, len(fit.frames) // 2):
        return fit
    corner_gate = max(_CORNER_GATE * typical, _LEAST_GATE_PX)
    kept = [
        (sight, length <= corner_gate)
        for sight, length in zip(fit.sights, lengths, strict=True)
        if sight.view not in bad
    ]
    number = {view: i for i, view in enumerate(views)}
    sights = tuple(
        replace(
            sight,
            view=number[sight.view],
            ids=sight.ids[ok] if ok.sum() >= _FEWEST_CORNERS else sight.ids,
            xy=sight.xy[ok] if ok.sum() >= _FEWEST_CORNERS else sight.xy,
        )
        for sight, ok in kept
    )
    lost = sum(len(sight.ids) for sight, _ in kept) - sum(len(sight.ids) for sight in sights)
    if not bad and not lost:
        return fit
    worst = {
        view: max(errors[i] for i, sight in enumerate(fit.sights) if sight.view == view)
        for view in bad
    }
    unknowns = replace(fit.adjusted.unknowns, poses=fit.adjusted.unknowns.poses[views])
    return replace(
        fit,
        sights=sights,
        frames=tuple(fit.frames[view] for view in views),
        adjusted=replace(fit.adjusted, unknowns=unknowns),
        dropped=(*fit.dropped, *((fit.frames[view], float(worst[view])) for view in sorted(bad))),
        dropped_corners=fit.dropped_corners + lost,
    )


def _from_simpler(lens: Lens, fits: Sequence[Fit]) -> Floats | None:
    """Intrinsics of a lens of the same model with fewer coefficients, the others 0."""
    for fit in reversed(fits):
        known = fit.lenses[0]
        if known.model == lens.model and known.coefficients < lens.coefficients:
            values = fit.adjusted.unknowns.intrinsics[0]
            return np.concatenate([values, np.zeros(lens.size - known.size)])
    return None


def _poses_by_frame(fit: Fit) -> dict[int, Floats]:
    return dict(zip(fit.frames, fit.adjusted.unknowns.poses, strict=True))
