"""From views of a board to a rig of cameras, with the figures that say how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vo.calibrating.adjustment import Sight
from vo.calibrating.board import Board
from vo.calibrating.fit import FEWEST_VIEWS, Fit, fit_camera, fit_pair
from vo.calibrating.projection import LENSES, camera_of
from vo.calibrating.survey import Survey, View, choose_views
from vo.errors import CalibrationError
from vo.geometry.cameras import normalise
from vo.geometry.transforms import make_transform, skew
from vo.types import Camera, Floats, Rig

_HOPELESS, _HOPELESS_PX = 5.0, 1.0
"""A pair is refused if its error is so many times that of each camera, and above."""

MODELS = {
    "auto": LENSES,
    "radtan": LENSES[:2],
    "equidistant": LENSES[2:3],
    "radtan8": LENSES[3:],
}
"""Lenses that are compared, by the name of the choice."""


@dataclass(frozen=True, eq=False)
class Result:
    """A calibrated rig.

    Attributes:
        board: what was looked at.
        survey: where it was found.
        size: width and height of the images.
        rig: the cameras.
        fit: views, corners, residuals and standard deviations behind it.
        compared: RMS in pixels of each lens that was compared, by camera.
        epipolar_px: frame and RMS distance from the epipolar lines, in stereo.
    """

    board: Board
    survey: Survey
    size: tuple[int, int]
    rig: Rig
    fit: Fit
    compared: tuple[dict[str, float], ...]
    epipolar_px: tuple[tuple[int, float], ...] = ()

    def sights_of(self, camera: int) -> list[tuple[Sight, Floats]]:
        """What a camera saw in the views that were used, with residuals (N, 2) in pixels."""
        pairs = zip(self.fit.sights, self.fit.adjusted.residuals, strict=True)
        return [(sight, residual) for sight, residual in pairs if sight.camera == camera]


def calibrate(
    board: Board, found: Survey, size: tuple[int, int], model: str = "auto", most_views: int = 60
) -> Result:
    """Calibrate the cameras of a recording.

    Args:
        board: what was looked for.
        found: where it was found.
        size: width and height of the images of each camera.
        model: a key of `MODELS`.
        most_views: how many views to calibrate each camera with, and as many for the pair.

    Raises:
        CalibrationError: too few views, or they fit no camera.
    """
    chosen = _choose(found, most_views, size)
    fits, compared = [], []
    for camera in range(found.cameras):
        sights, frames = _sights(chosen, camera)
        _check_count(found, camera, len(sights))
        fit, errors = fit_camera(MODELS[model], sights, frames, board.points, size)
        fits.append(fit)
        compared.append(errors)
    if found.cameras == 1:
        rig = Rig(camera_of(fits[0].lenses[0], fits[0].adjusted.unknowns.intrinsics[0], size))
        return Result(board, found, size, rig, fits[0], tuple(compared))
    pair = fit_pair(fits[0], fits[1], board.points, size)
    _check_together(pair, fits)
    rig = _rig(pair, size)
    return Result(board, found, size, rig, pair, tuple(compared), _epipolar(pair, rig))


def _choose(found: Survey, most: int, size: tuple[int, int]) -> list[View]:
    """Views of each camera, and in stereo as many that both see."""
    groups = [found.seen_by(camera) for camera in range(found.cameras)]
    if found.cameras == 1:
        return choose_views(groups[0], most, size)
    both = [view for view in groups[0] if view.sides[1] is not None]
    chosen = {view.frame: view for view in choose_views(both, most, size)}
    for camera, group in enumerate(groups):
        alone = [View(v.frame, v.stamp_ns, (v.sides[camera],)) for v in group]
        wanted = {view.frame for view in choose_views(alone, most // 2, size)}
        chosen.update({view.frame: view for view in group if view.frame in wanted})
    return [chosen[frame] for frame in sorted(chosen)]


def _sights(views: Sequence[View], camera: int) -> tuple[list[Sight], list[int]]:
    seen = [(view.frame, view.sides[camera]) for view in views]
    usable = [(frame, side) for frame, side in seen if side is not None]
    sights = [Sight(i, 0, side.ids, side.xy) for i, (_, side) in enumerate(usable)]
    return sights, [frame for frame, _ in usable]


def _check_count(found: Survey, camera: int, count: int) -> None:
    if count >= FEWEST_VIEWS:
        return
    whose = "" if found.cameras == 1 else f" of the {('left', 'right')[camera]} camera"
    seen = len(found.seen_by(camera))
    alike = f", which show it {count} different ways" if seen > count else ""
    raise CalibrationError(
        f"the board is seen in {seen} of {found.frames} images{whose}{alike}; {FEWEST_VIEWS} at "
        "the very least are needed, better 20: from near and far, tilted, in all parts of the image"
    )


def _check_together(pair: Fit, alone: Sequence[Fit]) -> None:
    """Refuse a pair that spoils the lenses, which were known well before."""
    error, least = pair.adjusted.rms_px, max(fit.adjusted.rms_px for fit in alone)
    if error > max(_HOPELESS * least, _HOPELESS_PX):
        raise CalibrationError(
            f"corners are off by {error:.2f} px in both cameras together, but by {least:.2f} px in "
            "each alone: they do not take their images at the same moment, or one moved against "
            "the other; hold the board still for each view, or calibrate one: --mode mono"
        )


def _rig(fit: Fit, size: tuple[int, int]) -> Rig:
    unknowns = fit.adjusted.unknowns
    assert unknowns.cam1_from_cam0 is not None
    cam0, cam1 = (
        camera_of(lens, values, size)
        for lens, values in zip(fit.lenses, unknowns.intrinsics, strict=True)
    )
    turn, _ = cv2.Rodrigues(unknowns.cam1_from_cam0[:3])
    return Rig(cam0, cam1, make_transform(turn, unknowns.cam1_from_cam0[3:]))


def _epipolar(fit: Fit, rig: Rig) -> tuple[tuple[int, float], ...]:
    """By how many pixels corners of cam1 miss the epipolar planes of those of cam0, by frame."""
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    sides: list[dict[int, Sight]] = [{}, {}]
    for sight in fit.sights:
        sides[sight.camera][sight.view] = sight
    errors = []
    for view in sorted(sides[0].keys() & sides[1].keys()):
        left, right = sides[0][view], sides[1][view]
        _, i, j = np.intersect1d(left.ids, right.ids, return_indices=True)
        if len(i):
            miss = _miss_px(rig, left.xy[i], right.xy[j])
            errors.append((fit.frames[view], float(np.sqrt(np.nanmean(miss**2)))))
    return tuple(errors)


def _miss_px(rig: Rig, left: Floats, right: Floats) -> Floats:
    """(N,) angles between rays of cam1 and planes of cam0's, in pixels at the image's centre."""
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    transform = rig.cam1_from_cam0
    essential = skew(transform[:3, 3]) @ transform[:3, :3]
    normals = _rays(rig.cam0, left) @ essential.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sine = np.sum(_rays(rig.cam1, right) * normals, axis=1)
    return np.asarray(np.arcsin(np.clip(sine, -1.0, 1.0)) * 0.5 * (rig.cam1.fx + rig.cam1.fy))


def _rays(camera: Camera, xy: Floats) -> Floats:
    rays = np.column_stack([normalise(camera, xy), np.ones(len(xy))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
