"""Calibration of a camera rig from views of a board, with its accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import normalise
from vo.base.geometry.transforms import make_transform, skew
from vo.base.types import Camera, Floats, Rig
from vo.tools.calibrating.board import Board
from vo.tools.calibrating.bundle_adjustment import Observation
from vo.tools.calibrating.fit import MIN_VIEWS, Fit, fit_camera, fit_pair
from vo.tools.calibrating.projection import LENS_MODELS, camera_of
from vo.tools.calibrating.views import DetectedViews, View, choose_views

_MAX_PAIR_ERROR_RATIO, _MAX_PAIR_ERROR_PX = 5.0, 1.0
"""A pair is refused if its error exceeds both limits, the former relative to single cameras."""

MODELS = {
    "auto": LENS_MODELS,
    "radtan": LENS_MODELS[:2],
    "equidistant": LENS_MODELS[2:3],
    "radtan8": LENS_MODELS[3:],
}
"""Lens models to compare, by choice of `--model`."""


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A calibrated rig."""

    board: Board
    detected: DetectedViews
    size: tuple[int, int]
    rig: Rig
    fit: Fit  # the views, corners, residuals and standard deviations
    # RMS error of each compared lens model by name, for each camera
    compared_rms_px: tuple[dict[str, float], ...]
    # Frame number and RMS distance from epipolar lines, with two cameras
    epipolar_px: tuple[tuple[int, float], ...] = ()

    def observations_of(self, camera: int) -> list[tuple[Observation, Floats]]:
        """Observations of a camera in the used views, with residuals (N, 2) in pixels."""
        pairs = zip(self.fit.observations, self.fit.adjustment.residuals, strict=True)
        return [
            (observation, residual)
            for observation, residual in pairs
            if observation.camera == camera
        ]


def calibrate(
    board: Board,
    detected: DetectedViews,
    size: tuple[int, int],
    model: str = "auto",
    max_views: int = 60,
) -> CalibrationResult:
    """Calibrate the cameras of a recording.

    `size`: width and height of the images of each camera. `model`: a key of `MODELS`. `max_views`:
    largest number of views for each camera, and for the pair.

    Raises:
        CalibrationError: too few views, or no camera fits them.
    """
    chosen = _choose(detected, max_views, size)
    fits, compared = [], []
    for camera in range(detected.cameras):
        observations, frames = _observations(chosen, camera)
        _check_count(detected, camera, len(observations))
        fit, errors = fit_camera(MODELS[model], observations, frames, board.points, size)
        fits.append(fit)
        compared.append(errors)
    if detected.cameras == 1:
        rig = Rig(camera_of(fits[0].lenses[0], fits[0].adjustment.parameters.intrinsics[0], size))
        return CalibrationResult(board, detected, size, rig, fits[0], tuple(compared))
    pair = fit_pair(fits[0], fits[1], board.points)
    _check_pair(pair, fits)
    rig = _rig(pair, size)
    return CalibrationResult(
        board, detected, size, rig, pair, tuple(compared), _epipolar(pair, rig)
    )


def _choose(detected: DetectedViews, max_views: int, size: tuple[int, int]) -> list[View]:
    """Choose views of each camera, and in stereo as many that both cameras see."""
    groups = [detected.seen_by(camera) for camera in range(detected.cameras)]
    if detected.cameras == 1:
        return choose_views(groups[0], max_views, size)
    both = [view for view in groups[0] if view.detections[1] is not None]
    chosen = {view.frame: view for view in choose_views(both, max_views, size)}
    for camera, group in enumerate(groups):
        alone = [View(v.frame, v.stamp_ns, (v.detections[camera],)) for v in group]
        more = {view.frame for view in choose_views(alone, max_views // 2, size)}
        chosen.update({view.frame: view for view in group if view.frame in more})
    return [chosen[frame] for frame in sorted(chosen)]


def _observations(views: Sequence[View], camera: int) -> tuple[list[Observation], list[int]]:
    seen = [(view.frame, view.detections[camera]) for view in views]
    usable = [(frame, side) for frame, side in seen if side is not None]
    observations = [Observation(i, 0, side.ids, side.xy) for i, (_, side) in enumerate(usable)]
    return observations, [frame for frame, _ in usable]


def _check_count(detected: DetectedViews, camera: int, count: int) -> None:
    if count >= MIN_VIEWS:
        return
    whose = "" if detected.cameras == 1 else f" of the {('left', 'right')[camera]} camera"
    seen = len(detected.seen_by(camera))
    distinct = f", but in only {count} different poses" if seen > count else ""
    raise CalibrationError(
        f"the board is seen in {seen} of {detected.frames} images{whose}{distinct}; at least "
        f"{MIN_VIEWS} different views are needed, better 20: near, far, tilted, in all parts of "
        "the image"
    )


def _check_pair(pair: Fit, alone: Sequence[Fit]) -> None:
    """Refuse a pair that fits much worse than each of its cameras alone."""
    error, single = pair.adjustment.rms_px, max(fit.adjustment.rms_px for fit in alone)
    if error > max(_MAX_PAIR_ERROR_RATIO * single, _MAX_PAIR_ERROR_PX):
        raise CalibrationError(
            f"corners are off by {error:.2f} px (RMS) if both cameras are calibrated together, but "
            f"by {single:.2f} px with each alone: the cameras do not expose at the same moment, or "
            "moved against each other; hold the board still for each view, or use `mode=mono`"
        )


def _rig(fit: Fit, size: tuple[int, int]) -> Rig:
    parameters = fit.adjustment.parameters
    assert parameters.cam1_from_cam0 is not None
    cam0, cam1 = (
        camera_of(lens, values, size)
        for lens, values in zip(fit.lenses, parameters.intrinsics, strict=True)
    )
    turn, _ = cv2.Rodrigues(parameters.cam1_from_cam0[:3])
    return Rig(cam0, cam1, make_transform(turn, parameters.cam1_from_cam0[3:]))


def _epipolar(fit: Fit, rig: Rig) -> tuple[tuple[int, float], ...]:
    """RMS distance of cam1's corners from the epipolar planes of cam0's, by frame, in pixels."""
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    by_view: list[dict[int, Observation]] = [{}, {}]
    for observation in fit.observations:
        by_view[observation.camera][observation.view] = observation
    errors = []
    for view in sorted(by_view[0].keys() & by_view[1].keys()):
        left, right = by_view[0][view], by_view[1][view]
        _, i, j = np.intersect1d(left.ids, right.ids, return_indices=True)
        if len(i):
            distances = _epipolar_distances_px(rig, left.xy[i], right.xy[j])
            errors.append((fit.frames[view], float(np.sqrt(np.nanmean(distances**2)))))
    return tuple(errors)


def _epipolar_distances_px(rig: Rig, left: Floats, right: Floats) -> Floats:
    """(N,) angles between rays and epipolar planes, in pixels at the centre of the image."""
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
