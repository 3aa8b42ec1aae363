"""A pair of cameras without calibration: both lenses, and one camera from the other.

Each lens is estimated from the images of its camera alone; the rotation between the cameras and the
direction of the baseline come from points that both see. The length of the baseline is given.
"""

from __future__ import annotations

import copy
import logging
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vo.base.config import Config
from vo.base.errors import CalibrationError, NoCalibration
from vo.base.geometry.cameras import normalise
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import make_transform
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.types import Camera, Floats, Frame, Rig
from vo.engine.frontend.contracts import feature_set
from vo.engine.frontend.matching import HammingMatcher
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.frontend.patch_alignment import PatchAligner, patches_of
from vo.engine.geometry import so3
from vo.engine.geometry.epipolar import (
    epipolar_errors,
    find_essential,
    fundamental_from_motion,
    recover_motion,
)
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.sources.camera_hint import camera_hint
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.source import Recording
from vo.recordings.sources.uncalibrated import open_uncalibrated
from vo.runs.camera_estimation import estimate_camera, same_lens, warn_of_estimate
from vo.runs.keyframe_tracking import TrackedKeyframes, track_keyframes, without_extras
from vo.runs.run_options import RunOptions

_log = logging.getLogger(__name__)

_FRAMES, _SPAN = 25, 300  # keyframes examined, of the first frames
_SAME_PX = 1.0  # of a feature and a landmark
_THRESHOLD_PX, _MIN_POINTS, _MIN_INLIERS = 2.0, 100, 0.5
_STEPS, _STEP, _HUBER = 20, 1e-6, 2.0
_ZOOM_SIGMA = 0.01  # of the focal length of the right camera, relative


def open_estimated_pair(
    source: Path | str, config: Config, options: RunOptions, missing: CalibrationError
) -> tuple[Recording, EstimatedCamera]:
    """Open a recording of a pair whose calibration is missing; `camera.baseline_m` is given.

    Raises:
        CalibrationError: the images do not show the lenses, or not where the cameras are.
    """
    baseline_m = config.camera.baseline_m
    assert baseline_m is not None
    _log.warning("%s: no calibration: both cameras are estimated first", source)
    opening: dict[str, Any] = {
        "format": options.format,
        "topics": options.topics,
        "mode": "stereo",
        "right_offset_ns": options.right_offset_ns,
        "side_by_side": options.side_by_side,
    }
    stream = open_uncalibrated(source, **opening)
    size = stream.rig.cam0.width, stream.rig.cam0.height
    hint = camera_hint(Path(source), stream.first_image, size)
    reason = NoCalibration(str(missing))
    left, found, _ = estimate_camera(_one(stream, 0), config, options, reason, hint)
    right = same_lens(_one(stream, 1), config, options, left, hint)
    stream.rig = Rig(left, right, np.eye(4))
    points = _common_points(stream, config, options)
    right, cam1_from_cam0 = _relative_pose(left, right, points)
    right = _with_offset(left, right, cam1_from_cam0, points)
    cam1_from_cam0[:3, 3] *= baseline_m
    with tempfile.TemporaryDirectory(prefix="vo-") as folder:
        file = Path(folder, "calibration.yaml")
        write_calibration(file, Rig(left, right, cam1_from_cam0))
        opened = open_source(source, calibration=file, **opening)
    warn_of_estimate(found)
    return opened, found


def _one(stream: ImageSequence, number: int) -> ImageSequence:
    """The images of one camera of a pair; a missing one is black."""

    def alone(frame: Frame) -> Frame:
        image = frame.images[number]
        black = np.zeros_like(frame.image0)
        return replace(frame, images=(black if image is None else image,), path=None)

    found = copy.copy(stream)
    found.rescale = alone
    return found


class _Common(NamedTuple):
    """The same points in left and right images: (N, 2) recorded pixels, (N,) inverse depths.

    Depths are those of a map by the left images alone, in its units; NaN where it has no landmark.
    """

    left: Floats
    right: Floats
    near: Floats


def _common_points(stream: ImageSequence, config: Config, options: RunOptions) -> _Common:
    """Points of keyframes of the left camera, whose calibration the stream has."""
    extractor, matcher = OrbExtractor(config.features), HammingMatcher(config.matching)
    patches = PatchAligner(config.patches)
    last = options.start + _SPAN * options.stride
    end = last if options.end is None else min(last, options.end)
    left = _one(stream, 0).frames(options.start, end, options.stride)
    tracked = track_keyframes(Rig(stream.rig.cam0), without_extras(config), left)
    rows = max(tracked.segments, key=len, default=[])
    found: list[_Common] = []
    for index in rows[:: max(len(rows) // _FRAMES, 1)]:
        for frame in stream.frames(index, index + 1):
            if frame.image1 is None:
                continue
            views = extractor.extract(frame.image0), extractor.extract(frame.image1)
            matches = matcher.match(feature_set(views[0]), feature_set(views[1]), ratio=0.8)
            at = views[0].xy[matches.query].astype(np.float64)
            start = views[1].xy[matches.train].astype(np.float64)
            aligned = patches.align(patches_of(frame.image0, at), frame.image1, start)
            good = patches.is_found(aligned)
            found.append(_Common(at[good], aligned.xy[good], _near(tracked, index, at[good])))
    if not found:
        return _Common(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))
    return _Common(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _near(tracked: TrackedKeyframes, index: int, xy: Floats) -> Floats:
    """Inverse depths (N,) of the landmarks that a keyframe observes at pixels; NaN without one."""
    sightings = tracked.sightings[index]
    known = np.array([n in tracked.points for n in sightings.ids.tolist()], dtype=bool)
    near = np.full(len(xy), np.nan)
    if not known.any():
        return near
    points = np.array([tracked.points[n] for n in sightings.ids[known].tolist()])
    pose = np.linalg.inv(tracked.poses[index].world_from_cam0)
    depth = points @ pose[2, :3] + pose[2, 3]
    seen = sightings.xy[known].astype(np.float64)
    for n, each in enumerate(xy):
        off = np.hypot(*(seen - each).T)
        best = int(np.argmin(off))
        if off[best] < _SAME_PX and depth[best] > 0.0:
            near[n] = 1.0 / depth[best]
    return near


def _with_offset(left: Camera, right: Camera, pose: Floats, points: _Common) -> Camera:
    """The right camera with its principal point moved along the baseline.

    Epipolar lines hardly show it, but it adds the same to all disparities, which else are in
    proportion to the inverse depths of the map: x1 - x0 = s w (tx - x1 tz) + offset, in rays turned
    like those of the left camera.
    """
    known = np.isfinite(points.near)
    first, turned = normalise(left, points.left[known]), normalise(right, points.right[known])
    rays = _homogeneous(turned) @ pose[:3, :3]
    second, near = rays[:, 0] / rays[:, 2], points.near[known]
    tx, _, tz = pose[:3, :3].T @ pose[:3, 3]
    columns = np.column_stack([near * (tx - second * tz), np.ones(len(near))])
    shift = second - first[:, 0]
    used = np.isfinite(columns).all(axis=1) & np.isfinite(shift)
    if used.sum() < _MIN_POINTS:
        return right
    columns, shift, weight = columns[used], shift[used], np.ones(int(used.sum()))
    for _ in range(_STEPS):
        solution = np.linalg.lstsq(columns * weight[:, None], shift * weight, rcond=None)[0]
        error = np.abs(shift - columns @ solution)
        weight = np.sqrt(1.0 / np.maximum(error / (_HUBER * max(median(error), 1e-6)), 1.0))
    _log.info("all disparities are off by %.2f px", solution[1] * right.fx)
    return replace(right, cx=right.cx + float(solution[1]) * right.fx)


def _relative_pose(left: Camera, right: Camera, points: _Common) -> tuple[Camera, Floats]:
    """The right camera with its focal length adjusted, and cam1_from_cam0 of unit length."""
    focal = left.fx
    rays = [normalise(left, points.left), normalise(right, points.right)]
    known = np.isfinite(rays[0]).all(axis=1) & np.isfinite(rays[1]).all(axis=1)
    first, second = (focal * each[known] for each in rays)
    matrix = np.diag([focal, focal, 1.0])
    found = find_essential(first, second, matrix, _THRESHOLD_PX)
    count = 0 if found is None else int(found[1].sum())
    if found is None or count < max(_MIN_POINTS, _MIN_INLIERS * len(first)):
        raise CalibrationError(
            f"the pair has no calibration, and {count} of {len(first)} points that both cameras "
            "see agree on where these are: do they look at the same things at the same time? Give "
            "`calibration=FILE`, or `mode=mono`"
        )
    essential, inlier = found
    start = recover_motion(essential, first, second, matrix, inlier)
    first, second = first[inlier], second[inlier]
    axes = np.linalg.svd(start[:3, 3][None])[2][1:]  # across the baseline

    def at(state: Floats) -> tuple[Floats, Floats]:
        """Pose, and signed distances to epipolar lines, for (rotation, baseline, log focal)."""
        along = start[:3, 3] + state[3:5] @ axes
        pose = make_transform(so3.exp(state[None, :3])[0] @ start[:3, :3], along)
        pose[:3, 3] /= np.linalg.norm(along)
        fundamental = fundamental_from_motion(pose, matrix)
        shrunk = second * np.exp(-state[5])
        in_right, in_left = epipolar_errors(fundamental, first, shrunk)
        sign = np.sign(np.sum(_homogeneous(shrunk) * (_homogeneous(first) @ fundamental.T), axis=1))
        return pose, sign * np.sqrt(0.5 * (in_right + in_left))

    state = np.zeros(6)
    for _ in range(_STEPS):
        error = at(state)[1]
        sigma = max(median(np.abs(error)) / 0.6745, 0.05)
        weight = 1.0 / np.maximum(np.abs(error) / (_HUBER * sigma), 1.0) / sigma**2
        columns = [(at(state + _STEP * axis)[1] - error) / _STEP for axis in np.eye(6)]
        jacobian = np.stack(columns, axis=1)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        gradient = jacobian.T @ (weight * error)
        normal[5, 5] += _ZOOM_SIGMA**-2
        gradient[5] += state[5] * _ZOOM_SIGMA**-2
        step = -np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(6), gradient)
        state = state + step
        if np.abs(step).max() < 1e-7:
            break
    pose, error = at(state)
    _log.info("%d points of the pair agree within %.2f px", len(error), median(np.abs(error)))
    focal = right.fx * float(np.exp(state[5]))
    return replace(right, fx=focal, fy=focal), pose


def _homogeneous(xy: Floats) -> Floats:
    return np.column_stack([xy, np.ones(len(xy))])
