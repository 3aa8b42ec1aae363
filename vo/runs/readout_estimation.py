"""The readout time of a rolling shutter, estimated from the images.

The keyframes are adjusted with several readout times, pixels moved to the time of the middle row
with the velocity of the path (Chaumette and Hutchinson, "Visual servo control, part I", 2006, eq.
11). The square of the median residual is a parabola of it: the lowest point is the answer.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.config import Config, SmoothingConfig
from vo.base.geometry.cameras import ideal_pixels
from vo.base.geometry.transforms import inverse, se3_log
from vo.base.types import Estimate, Floats, Rig
from vo.engine.backend.lens_adjustment import (
    IDEAL,
    AdjustedLens,
    KeyframeViews,
    Lens,
    adjust_lens,
    undistorted,
)
from vo.recordings.sources.sequence import ImageSequence
from vo.runs.keyframe_tracking import track_keyframes, without_extras
from vo.runs.run_options import RunOptions

_log = logging.getLogger(__name__)

_FRAMES, _MAX_KEYFRAMES, _MIN_KEYFRAMES = 300, 150, 9  # of a recording whose camera is known
_PARTS = 3  # whose scatter is the standard deviation
_STEP, _FINE_STEP = 0.3, 0.15  # of readout times that are tried, in intervals between frames
_ROUNDS = 2  # of adjustment at each, as depths and the lens change
_MAX_READOUT = 0.97  # in intervals
# A readout time counts if it is so long, in intervals, and so many standard deviations from none,
# and takes so much off the square of residuals.
_MIN_READOUT, _SIGNIFICANT, _MIN_EXPLAINED = 0.1, 3.0, 0.04


class Readout(NamedTuple):
    """A readout time and its standard deviation in seconds; 0 for a global shutter."""

    seconds: float = 0.0
    sigma_s: float = 0.0


def readout_by_images(stream: ImageSequence, config: Config, options: RunOptions) -> float:
    """Seconds, for a calibrated camera, from the beginning of its recording."""
    camera = replace(stream.rig.cam0, readout_s=0.0)
    end = options.start + _FRAMES * options.stride
    end = end if options.end is None else min(end, options.end)
    frames = stream.frames(options.start, end, options.stride)
    left = (replace(frame, images=frame.images[:1], depth=None) for frame in frames)
    tracked = track_keyframes(Rig(camera), without_extras(config), left)
    rows = max(tracked.segments, key=len, default=[])[:_MAX_KEYFRAMES]
    found = Readout()
    if len(rows) >= _MIN_KEYFRAMES:
        views = tracked.views(rows, 0.5 * np.array([camera.width - 1.0, camera.height - 1.0]))
        views = replace(views, xy=ideal_pixels(camera, views.xy))
        try:
            adjusted = adjust_lens(
                views, Lens(camera.fx, camera.cx, camera.cy), config.smoothing, IDEAL
            )
            velocity = velocities(tracked.path, rows)
            fit = ReadoutFit(views, velocity, interval_s(tracked.path), config.smoothing, IDEAL)
            found = fit.readout(adjusted.lens)
        except np.linalg.LinAlgError:
            _log.info("the keyframes do not determine the readout time")
    ms, sigma_ms = 1e3 * found.seconds, 1e3 * found.sigma_s
    words = (
        f"rows are read within {ms:.1f} ± {sigma_ms:.1f} ms" if ms else "no rolling shutter is seen"
    )
    _log.warning("%s: %s by the images (`camera.readout_s=auto`)", stream.name, words)
    return round(found.seconds, 5)


def interval_s(path: Sequence[Estimate]) -> float:
    """The usual time between frames."""
    return 1e-9 * float(np.median(np.diff([each.stamp_ns for each in path])))


def velocities(path: Sequence[Estimate], keyframes: Sequence[int]) -> Floats:
    """(K, 6) angular and linear velocity of keyframes per second, in their frames; 0 if unknown."""
    by_index = {each.frame_index: each for each in path}
    found = np.zeros((len(keyframes), 6))
    for row, number in enumerate(keyframes):
        around = [by_index[n] for n in (number - 1, number, number + 1) if n in by_index]
        if len(around) < 2:
            continue
        first, last = around[0], around[-1]
        assert first.world_from_cam0 is not None and last.world_from_cam0 is not None
        motion = inverse(first.world_from_cam0) @ last.world_from_cam0
        found[row] = se3_log(motion) * 1e9 / (last.stamp_ns - first.stamp_ns)
    return found


def at_middle_row(
    views: KeyframeViews, lens: Lens, velocity: Floats, seconds: float, recorded: Floats
) -> KeyframeViews:
    """Views with their pixels at the time of the middle row.

    Args:
        views: with depths, poses and velocities in the same unit.
        lens: that of the recorded pixels.
        velocity: (K, 6) of the keyframes.
        seconds: from the first to the last row.
        recorded: (N, 2) pixels as they were read.
    """
    xy, larger = undistorted(recorded, lens)
    x, y = (xy - (lens.cx, lens.cy)).T / lens.focal
    cam_from_world = inverse(views.world_from_cam)[views.keyframe]
    depth = (cam_from_world[:, 2, :3] * views.points[views.point]).sum(axis=1)
    depth += cam_from_world[:, 2, 3]
    near = np.where(depth > 0.0, 1.0 / np.maximum(depth, 1e-9), 0.0)
    turn, shift = velocity[views.keyframe, :3].T, velocity[views.keyframe, 3:].T * near
    along = turn[0] * y - turn[1] * x + shift[2]  # (x, y, 1) moves by -turn x (x, y, 1) - shift
    per_s = np.stack([turn[2] * y - turn[1] - shift[0], turn[0] - turn[2] * x - shift[1]], axis=1)
    per_s += along[:, None] * np.stack([x, y], axis=1)
    row = recorded[:, 1:] / (2.0 * views.middle[1]) - 0.5
    return replace(views, xy=recorded - seconds * lens.focal * row * per_s / larger[:, None])


class ReadoutFit(NamedTuple):
    """What a readout time is found from.

    Attributes:
        views: recorded pixels, with poses and points before adjustment.
        velocity: (K, 6) of the keyframes, in the unit of the poses.
        interval_s: between frames.
        config: of the adjustment.
        columns: of the lens that are adjusted.
    """

    views: KeyframeViews
    velocity: Floats
    interval_s: float
    config: SmoothingConfig
    columns: tuple[int, ...]

    def readout(self, lens: Lens) -> Readout:
        """The readout time, 0 where it is not significant.

        Raises:
            numpy.linalg.LinAlgError: the keyframes do not determine it.
        """
        whole, explained = self._lowest(lens)
        bounds = np.linspace(0, len(self.velocity), _PARTS + 1).astype(int)
        found = []
        for first, last in zip(bounds[:-1], bounds[1:], strict=True):
            views, velocity = self.views.part(first, last), self.velocity[first:last]
            found.append(self._replace(views=views, velocity=velocity)._lowest(lens)[0])
        sigma = (
            float(np.std(found, ddof=1)) / np.sqrt(_PARTS) if np.isfinite(found).all() else np.inf
        )
        _log.info("readout: %.3f ± %.3f intervals, explains %.3f", whole, sigma, explained)
        is_found = _MIN_READOUT < whole < _MAX_READOUT and explained > _MIN_EXPLAINED
        if not (is_found and whole > _SIGNIFICANT * sigma):
            return Readout()
        finer, _ = self._lowest(lens, whole - _FINE_STEP, _FINE_STEP)  # there it is a parabola
        if abs(finer - whole) < _FINE_STEP:
            whole = finer
        return Readout(self.interval_s * whole, self.interval_s * sigma)

    def _lowest(self, lens: Lens, first: float = 0.0, step: float = _STEP) -> tuple[float, float]:
        """The lowest point of the parabola in intervals, and what it explains of the first cost."""
        cost = [self._adjusted(lens, self.interval_s * (first + n * step)) for n in range(3)]
        curvature = cost[0] - 2.0 * cost[1] + cost[2]
        if not curvature > 0.0:
            return np.inf, 0.0
        steps = float(1.0 - 0.5 * (cost[2] - cost[0]) / curvature)
        return first + step * steps, float(0.5 * curvature * steps * steps / cost[0])

    def _adjusted(self, lens: Lens, seconds: float) -> float:
        views, velocity, adjusted = self.views, self.velocity, AdjustedLens(lens, self.views)
        for _ in range(_ROUNDS):
            moved = at_middle_row(views, adjusted.lens, velocity, seconds, self.views.xy)
            adjusted = adjust_lens(moved, adjusted.lens, self.config, self.columns)
            unit = _extent(self.views) / _extent(adjusted.views)
            velocity = self.velocity / np.repeat([1.0, unit], 3)
            views = adjusted.views
        return adjusted.residual_px**2


def _extent(views: KeyframeViews) -> float:
    return float(np.linalg.norm(np.ptp(views.world_from_cam[:, :3, 3], axis=0)))
