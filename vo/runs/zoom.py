"""A focal length that changes during a recording: it is followed, and the images made alike.

The keyframes of a run are adjusted together with a focal length for each of them, and the images
enlarged to the longest one; that is done twice, because a zoom that is not known bends the map.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vo.base.config import Config
from vo.base.records.focal_length import MAX_SIGMA, FocalLength, focal_change
from vo.base.types import Camera, Frame, Ints, Rig, with_image0
from vo.engine.backend.lens_adjustment import KeyframeViews
from vo.recordings.sources.rescaling import at_constant_focal_length
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.source import FrameStream
from vo.runs.focal_adjustment import AdjustedFocal, FocalPrior, adjust_focal_lengths
from vo.runs.keyframe_tracking import (
    TrackedKeyframes,
    track_keyframes,
    with_more_keyframes,
    without_extras,
)
from vo.runs.run_options import RunOptions

_log = logging.getLogger(__name__)

_PASSES, _SETTLED = 3, 0.003  # until logarithms change by less
_KEYFRAMES, _OVERLAP, _MIN_KEYFRAMES = 60, 15, 4  # adjusted together
_MAX_POINTS = 1500  # those in most keyframes
_FIRST_SIGMA = 0.001  # the first images are as calibrated
# A wrong calibration, as of stabilised images, is no zoom, but would be taken for one: the first
# three keyframes of a hall with images cropped by 12 % are off by 1.6 %, of zooms by 0.13 %.
_FIRST, _MAX_FIRST = 3, 0.007
_WALK = 0.03  # standard deviation of the logarithm after a second
# By what a varying focal length divides residuals: zooms by 3 and 8 % 1.46 and 2.02, drives of
# KITTI, whose motion hardly shows the focal length, 1.07.
_CONSTANT, _MIN_EXPLAINED = 1e-6, 1.2
_MIN_CHANGE, _MIN_SIGNIFICANCE = 0.01, 5.0


def follow_focal_length(
    stream: FrameStream, config: Config, options: RunOptions
) -> tuple[FrameStream, tuple[FocalLength, ...]]:
    """The recording at a constant focal length, and what it was; unchanged if that is constant."""
    _log.warning("the focal length may change in %s: it is estimated first", stream.name)
    assert isinstance(stream, ImageSequence)
    denser = with_more_keyframes(without_extras(config))
    current = stream
    found: tuple[FocalLength, ...] = ()
    spans: list[tuple[int, int]] | None = None
    for _ in range(_PASSES):
        frames = _left_images(current, config, options)
        tracked = track_keyframes(Rig(current.rig.cam0), denser, frames)
        walk = _Walk(tracked, current.rig.cam0, spans)
        stamps_ns, logs, sigma = walk.stamps_ns, walk.logs, walk.sigmas
        spans = walk.spans
        if not spans:
            break
        before = np.zeros(len(logs))
        if found:
            known = [np.log(each.focal_px / stream.rig.cam0.fx) for each in found]
            before = np.interp(stamps_ns, [each.stamp_ns for each in found], known)
        if np.abs((before + logs)[:_FIRST]).max() > _MAX_FIRST:
            _log.info("the focal length is not as calibrated from the first frames on")
            return stream, ()
        focal_px = stream.rig.cam0.fx * np.exp(before + logs)
        rows = zip(stamps_ns.tolist(), focal_px.tolist(), (focal_px * sigma).tolist(), strict=True)
        found = tuple(FocalLength(t, round(f, 3), round(s, 3)) for t, f, s in rows)
        _log.info("focal lengths %s", [each.focal_px for each in found])
        current = at_constant_focal_length(stream, found)
        if np.abs(logs).max() < _SETTLED:
            break
    change = focal_change(found)
    spread = max((each.sigma_px / each.focal_px for each in found), default=np.inf)
    if abs(change) < max(_MIN_CHANGE, _MIN_SIGNIFICANCE * min(spread, MAX_SIGMA)):
        return stream, ()
    return current, found


def _left_images(stream: ImageSequence, config: Config, options: RunOptions) -> Iterator[Frame]:
    stride = options.stride * config.tracking.every
    for frame in with_image0(stream.frames(options.start, options.end, stride)):
        yield replace(frame, images=frame.images[:1], depth=None)


class _Walk:
    """Focal lengths of keyframes, adjusted part by part.

    Attributes:
        stamps_ns, logs, sigmas: of keyframes; logarithms of their focal lengths over the camera's.
        spans: times of the parts where it changes.
    """

    def __init__(
        self, tracked: TrackedKeyframes, camera: Camera, spans: list[tuple[int, int]] | None
    ) -> None:
        """Adjust the parts that overlap `spans`; None for all whose residuals show a change."""
        self.stamps_ns, self.logs, self.sigmas = np.empty(0, np.int64), np.empty(0), np.empty(0)
        self.spans: list[tuple[int, int]] = []
        self._tracked, self._camera, self._asked = tracked, camera, spans
        for rows in tracked.segments:
            for first in range(0, len(rows), _KEYFRAMES - _OVERLAP):
                part = rows[first : first + _KEYFRAMES]
                new = len(part) if first == 0 else len(part) - _OVERLAP
                if new > 0:
                    self._add(part, new)

    def _add(self, part: list[int], new: int) -> None:
        stamps_ns = np.array([self._tracked.poses[n].stamp_ns for n in part])
        prior = self._prior(stamps_ns)
        adjusted = self._adjusted(part, prior, (int(stamps_ns[0]), int(stamps_ns[-1])))
        if adjusted is None:
            sigma = np.full(len(part), prior.sigma[0])
            adjusted = AdjustedFocal(np.full(len(part), prior.log_focal[0]), sigma, 0.0)
        self.stamps_ns = np.append(self.stamps_ns, stamps_ns[-new:])
        self.logs = np.append(self.logs, adjusted.log_focal[-new:])
        self.sigmas = np.append(self.sigmas, adjusted.sigma[-new:])

    def _adjusted(
        self, part: list[int], prior: FocalPrior, span: tuple[int, int]
    ) -> AdjustedFocal | None:
        asked, camera = self._asked, self._camera
        is_asked = asked is None or any(a <= span[1] and span[0] <= b for a, b in asked)
        if len(part) < _MIN_KEYFRAMES or not is_asked:
            return None
        views = _most_seen(self._tracked.views(part, np.array([camera.cx, camera.cy])))
        try:
            found = adjust_focal_lengths(views, camera, prior)
            if asked is None:
                rigid = prior._replace(step_sigma=np.full(len(part) - 1, _CONSTANT))
                constant = adjust_focal_lengths(views, camera, rigid)
                explained = constant.residual_px / found.residual_px
                _log.info("a varying focal length divides residuals by %.2f", explained)
                if explained < _MIN_EXPLAINED:
                    return None
        except np.linalg.LinAlgError:
            return None
        self.spans.append(span)
        return found

    def _prior(self, stamps_ns: Ints) -> FocalPrior:
        """Of keyframes, by those before them."""
        sigma = np.full(len(stamps_ns), np.inf)
        steps = _WALK * np.sqrt(np.maximum(np.diff(stamps_ns) * 1e-9, 1e-9))
        if not len(self.logs):
            sigma[0] = _FIRST_SIGMA
            return FocalPrior(np.zeros(len(stamps_ns)), sigma, steps)
        begun = np.interp(stamps_ns, self.stamps_ns, self.logs)
        since_s = max(0.0, 1e-9 * float(stamps_ns[0] - self.stamps_ns[-1]))
        before = float(np.interp(stamps_ns[0], self.stamps_ns, self.sigmas))
        sigma[0] = np.hypot(before, _WALK * np.sqrt(since_s))
        return FocalPrior(begun, sigma, steps)


def _most_seen(views: KeyframeViews) -> KeyframeViews:
    """With at most so many landmarks, those that most keyframes observe."""
    seen = np.bincount(views.point, minlength=len(views.points))
    used = np.zeros(len(seen), dtype=bool)
    used[np.argsort(-seen, kind="stable")[:_MAX_POINTS]] = True
    kept = used[views.point]
    point = (np.cumsum(used) - 1)[views.point[kept]]
    return replace(
        views,
        points=views.points[used],
        keyframe=views.keyframe[kept],
        point=point,
        xy=views.xy[kept],
    )
