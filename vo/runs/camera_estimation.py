"""A camera without calibration: its focal length and distortion from the images of a recording.

The odometry runs over the beginning of the recording with several guesses, and the keyframes of
each are adjusted together with the lens. From the guess that explains the images best, odometry
and adjustment follow each other over more frames until the lens stays as it is.
"""

from __future__ import annotations

import copy
import logging
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.config import Config
from vo.base.errors import CalibrationError, NoCalibration
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.types import Camera, Estimate, Floats, Frame, Landmarks, Rig
from vo.engine.backend.lens_adjustment import (
    FROM_A_GUESS,
    IDEAL,
    WITH_CENTRE,
    AdjustedLens,
    KeyframeViews,
    Lens,
    adjust_lens,
)
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.camera_hint import NO_HINT, CameraHint, camera_hint
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import Recording
from vo.runs.keyframe_tracking import (
    TrackedKeyframes,
    track_keyframes,
    with_more_keyframes,
    without_extras,
)
from vo.runs.readout_estimation import (
    Readout,
    ReadoutFit,
    at_middle_row,
    interval_s,
    velocities,
)
from vo.runs.run_options import RunOptions

_log = logging.getLogger(__name__)

_FIELDS_DEG, _GUESSED_K1 = (50.0, 65.0, 80.0, 100.0), (0.0, -0.25)  # guesses: across the image, k1
_FIRST_FRAMES, _FRAMES = 100, 300
_MIN_KEYFRAMES, _MIN_OBSERVATIONS = 4, 200
_MAX_KEYFRAMES = 150
_MIN_TRACKED = 0.85  # of the frames that the best guess has tracked
_WIDTHS = (0.25, 2.5)  # focal lengths in image widths that cameras have
_IDEAL_K1 = 0.008  # below it a lens, as of rectified images, is not told from an ideal one
_PASSES, _CONVERGED = 4, 0.004  # change of the focal length
# Standard deviation of the focal length: of twelve recordings, and by parts of this one.
_PARTS, _SYSTEMATIC, _PER_PART = 3, 0.008, 0.6
# A given focal length is wrong by so much, and so many standard deviations. Thirds of KITTI, whose
# lenses are wrong in another way, differ by 4 % from each other; of a focal length that is wrong
# by 5 %, by 1.5.
_MIN_WRONG, _SIGNIFICANT = 0.015, 3.0


class _Tracked(NamedTuple):
    path: list[Estimate]  # frames with a pose
    views: KeyframeViews
    velocity: Floats  # (K, 6) of the keyframes


def open_estimated(
    source: Path | str, config: Config, options: RunOptions, missing: NoCalibration
) -> tuple[Recording, EstimatedCamera]:
    """Open a recording of one camera whose calibration is missing.

    Raises:
        CalibrationError: the images do not show the lens either.
    """
    # The check of a calibration needs neither of these.
    from vo.recordings.sources.uncalibrated import open_uncalibrated
    from vo.runs.sensor_alignment import align_sensor

    _log.warning("%s: no calibration: focal length and distortion are estimated first", source)
    opening = {"format": options.format, "topics": options.topics}
    stream = open_uncalibrated(source, mode="mono", **opening)  # type: ignore[arg-type]
    size = stream.rig.cam0.width, stream.rig.cam0.height
    hint = camera_hint(Path(source), stream.first_image, size)
    camera, found, path = estimate_camera(stream, config, options, missing, hint)
    sensor = next(iter(stream.imus), None)
    is_loose = sensor is not None and sensor.cam0_from_imu is None
    imu = align_sensor(stream.imus[0], path) if is_loose else None
    with tempfile.TemporaryDirectory(prefix="vo-") as folder:
        file = Path(folder, "calibration.yaml")
        write_calibration(file, Rig(camera), imu=imu)
        opened = open_source(source, calibration=file, mode="mono", **opening)  # type: ignore[arg-type]
    warn_of_estimate(found)
    return opened, found


def warn_of_estimate(found: EstimatedCamera) -> None:
    """Say what was found, and how certain it is."""
    if found.is_uncertain:
        _log.warning(
            "the camera was estimated without a calibration, and its motion hardly shows the focal "
            "length (%s): angles and the shape of the path may be wrong; give `calibration=FILE`",
            found.in_words,
            extra=warning_kind("calibration"),
        )
    else:
        _log.warning(
            "the camera was estimated without a calibration: %s; lengths and turns of the path are "
            "as good as these, and a calibration is better: vo calibrate",
            found.in_words,
        )


def estimate_camera(
    stream: Recording,
    config: Config,
    options: RunOptions,
    missing: NoCalibration,
    hint: CameraHint = NO_HINT,
) -> tuple[Camera, EstimatedCamera, list[Estimate]]:
    """The camera of a recording, with equal focal lengths along both axes, and a path by it.

    Raises:
        CalibrationError: no guess leads to a path with parallax.
    """
    search = _Search(stream, config, options, hint)
    best = search.best_guess()
    if best is None and hint.is_known:
        told = search.told
        found = EstimatedCamera(told.focal, round(hint.sigma_px, 3), *told[1:], 0, hint.told_by)
        return search.camera(told), found, []
    if best is None:
        raise CalibrationError(
            f"{missing}; it cannot be estimated from the images: none of the usual fields of view "
            f"leads to a path in the first {_FIRST_FRAMES} frames (an estimate needs a camera that "
            "moves, not only turns, and texture)"
        )
    return _estimated(search, best.lens)


def corrected_camera(
    stream: Recording,
    config: Config,
    options: RunOptions,
    seen: Sequence[tuple[Estimate, Landmarks | None]],
) -> tuple[Camera, EstimatedCamera] | None:
    """The camera of a calibration that the images contradict, None where they do not.

    First each third of the keyframes has to find the same other focal length; then the camera is
    estimated as one without calibration is.
    """
    camera, tracked = stream.rig.cam0, TrackedKeyframes([], {}, {}, {})
    for each in seen:
        tracked.add(*each)
    rows = max(tracked.segments, key=len, default=[])
    if len(rows) < _PARTS * _MIN_KEYFRAMES or camera.distortion_model not in ("none", "radtan"):
        return None
    search = _Search(stream, config, options, CameraHint(readout_s=camera.readout_s))
    k1, k2 = camera.distortion[:2] if camera.distortion else (0.0, 0.0)
    given = Lens(float(np.sqrt(camera.fx * camera.fy)), camera.cx, camera.cy, k1, k2)
    views = tracked.views(rows, np.array(search.middle))
    changes = []
    # The last third first: the lens has been corrected when it was tracked, so that it is adjusted
    # in fewer steps, and is the first to agree with the calibration.
    for part in search.parts(AdjustedLens(given, views), last_first=True):
        changes.append(float(np.log(part.lens.focal / given.focal)))
        if abs(changes[-1]) < _MIN_WRONG:
            return None
    sigma = float(np.std(changes, ddof=1)) / np.sqrt(_PARTS)
    if len(changes) < _PARTS or not _is_wrong(np.array(changes), sigma):
        return None
    try:
        lens, estimated, _ = _estimated(search, given)
    except CalibrationError:
        return None
    change = np.log([estimated.focal_px / given.focal])
    return (lens, estimated) if _is_wrong(change, estimated.sigma_px / estimated.focal_px) else None


def _is_wrong(change: Floats, sigma: float) -> bool:
    """Whether logarithms of a focal length say that it is another one."""
    least = max(_MIN_WRONG, _SIGNIFICANT * sigma)
    return bool(abs(change.mean()) > least and (np.sign(change) == np.sign(change[0])).all())


def _estimated(search: _Search, guess: Lens) -> tuple[Camera, EstimatedCamera, list[Estimate]]:
    """The camera from a guess, with its standard deviation, and a path by it."""
    hint = search.hint
    adjusted, tracked = search.converged(guess)
    readout = search.readout(adjusted.lens, tracked) if hint.readout_s == 0.0 else Readout()
    if readout.seconds:
        search = search.with_readout(readout.seconds)
        adjusted, tracked = search.converged(adjusted.lens)
    path = tracked.path
    deviation = [p.lens.focal / adjusted.lens.focal - 1.0 for p in search.parts(adjusted)]
    spread = _PER_PART * float(np.sqrt(np.mean(np.square(deviation)))) if deviation else 1.0
    lens = Lens(*(round(float(value), 6) + 0.0 for value in adjusted.lens))
    sigma = lens.focal * float(np.linalg.norm([_SYSTEMATIC, spread, adjusted.relative_sigma]))
    if hint.sigma_px < sigma:  # the motion says less than the camera
        lens, sigma = search.told, hint.sigma_px
    found = EstimatedCamera(
        lens.focal,
        round(sigma, 3),
        *lens[1:],
        len(path),
        hint.told_by,
        *(round(each, 5) for each in readout),
    )
    return search.camera(lens), found, path


def same_lens(
    stream: Recording, config: Config, options: RunOptions, camera: Camera, hint: CameraHint
) -> Camera:
    """The other camera of a pair, whose lens is nearly that of this one."""
    search = _Search(stream, config, options, hint)
    k1, k2 = camera.distortion[:2] if camera.distortion else (0.0, 0.0)
    return search.camera(search.converged(Lens(camera.fx, *search.middle, k1, k2))[0].lens)


class _Search:
    def __init__(
        self, stream: Recording, config: Config, options: RunOptions, hint: CameraHint
    ) -> None:
        self._stream, self._options, self.hint = stream, options, hint
        self._size = stream.rig.cam0.width, stream.rig.cam0.height
        self.middle = (self._size[0] - 1.0) / 2.0, (self._size[1] - 1.0) / 2.0
        self._config = without_extras(config)

    def with_readout(self, seconds: float) -> _Search:
        """The same for a rolling shutter."""
        found = copy.copy(self)
        found.hint = self.hint._replace(readout_s=seconds)
        return found

    @property
    def told(self) -> Lens:
        """The lens as the camera says."""
        return Lens(round(self.hint.focal_px, 6), *self.middle)

    def camera(self, lens: Lens) -> Camera:
        """The camera with a lens, in OpenCV's model."""
        focal, cx, cy, k1, k2 = lens
        found = Camera(*self._size, focal, focal, cx, cy, readout_s=self.hint.readout_s)
        if k1 == k2 == 0.0:
            return found
        return replace(found, distortion_model="radtan", distortion=(k1, k2, 0.0, 0.0))

    def best_guess(self) -> AdjustedLens | None:
        """The adjusted guess with the smallest residuals, of those that track most frames."""
        told = self._best_of([self.hint.focal_px]) if self.hint.is_known else None
        half = [float(np.tan(np.radians(field / 2.0))) for field in _FIELDS_DEG]
        return told or self._best_of([0.5 * self._size[0] / each for each in half])

    def _best_of(self, focals: Sequence[float]) -> AdjustedLens | None:
        width, found = self._size[0], []
        for focal in focals:
            for k1 in _GUESSED_K1:
                lens = Lens(focal, *self.middle, k1, 1.2 * k1 * k1)
                tracked = self._tracked(lens, _FIRST_FRAMES)
                adjusted = (
                    None if tracked is None else self._adjusted(tracked.views, lens, FROM_A_GUESS)
                )
                if tracked is None or adjusted is None:
                    continue
                _log.info("%.0f px, k1 %.2f: %s, %.3f px", focal, k1, *adjusted[::2])
                if _WIDTHS[0] < adjusted.lens.focal / width < _WIDTHS[1]:
                    found.append((len(tracked.path), adjusted))
        most = max((frames for frames, _ in found), default=0)
        usable = [each for frames, each in found if frames >= _MIN_TRACKED * most]
        return min(usable, key=lambda each: each.residual_px, default=None)

    def readout(self, lens: Lens, tracked: _Tracked) -> Readout:
        """The time in which rows are read."""
        columns = IDEAL if lens.k1 == 0.0 else WITH_CENTRE
        interval = interval_s(tracked.path)
        fit = ReadoutFit(tracked.views, tracked.velocity, interval, self._config.smoothing, columns)
        try:
            return fit.readout(lens)
        except np.linalg.LinAlgError:
            return Readout()

    def converged(self, lens: Lens) -> tuple[AdjustedLens, _Tracked]:
        """The lens once it stays as it is, and what was tracked for it."""
        adjusted: AdjustedLens | None = None
        used: _Tracked | None = None
        for number in range(_PASSES):
            tracked = self._tracked(lens, _FIRST_FRAMES if number == 0 else _FRAMES)
            again = None
            if tracked is not None:
                again = self._adjusted(tracked.views, lens, WITH_CENTRE)
            if tracked is None or again is None:
                if number > 0:
                    break
                # With the right lens there may be too few keyframes.
                self._config = with_more_keyframes(self._config)
                continue
            change = abs(again.lens.focal / lens.focal - 1.0)
            adjusted, used, lens = again, tracked, again.lens
            _log.info("over %d frames: %s", len(used.path), lens)
            if number > 0 and change < _CONVERGED:
                break
        if adjusted is None or used is None:
            raise CalibrationError(
                "no calibration: the camera that was estimated from the first frames leads to no "
                "path (an estimate needs a camera that moves, not only turns, and texture); give "
                "`calibration=FILE`"
            )
        if abs(lens.k1) < _IDEAL_K1:
            straight = lens._replace(k1=0.0, k2=0.0)
            adjusted = self._adjusted(adjusted.views, straight, IDEAL) or adjusted
        return adjusted, used

    def parts(self, adjusted: AdjustedLens, *, last_first: bool = False) -> Iterator[AdjustedLens]:
        """The lens by each third of the keyframes alone, or each half of few."""
        keyframes = len(adjusted.views.world_from_cam)
        count = _PARTS if keyframes >= _PARTS * _MIN_KEYFRAMES else 2
        bounds = np.linspace(0, keyframes, count + 1).astype(int)
        columns = IDEAL if adjusted.lens.k1 == 0.0 else WITH_CENTRE
        parts = list(zip(bounds[:-1], bounds[1:], strict=True))
        for first, last in reversed(parts) if last_first else parts:
            if last - first >= _MIN_KEYFRAMES:
                views = adjusted.views.part(first, last)
                part = self._adjusted(views, adjusted.lens, columns)
                if part is not None:
                    yield part

    def _adjusted(
        self, views: KeyframeViews, lens: Lens, columns: tuple[int, ...]
    ) -> AdjustedLens | None:
        if len(views.xy) < _MIN_OBSERVATIONS:
            return None
        try:
            adjusted = adjust_lens(views, lens, self._config.smoothing, columns)
        except np.linalg.LinAlgError:
            return None
        return adjusted if np.isfinite([*adjusted.lens, adjusted.residual_px]).all() else None

    def _tracked(self, lens: Lens, count: int) -> _Tracked | None:
        """The path of the first frames by a lens, and the keyframes of its largest segment."""
        tracked = track_keyframes(Rig(self.camera(lens)), self._config, self._frames(count))
        segments = sorted(tracked.segments, key=len, reverse=True)  # stable: the earlier of equals
        if not segments or len(segments[0]) < _MIN_KEYFRAMES:
            return None
        rows = segments[0][:_MAX_KEYFRAMES]
        views, velocity = tracked.views(rows, np.array(self.middle)), velocities(tracked.path, rows)
        if self.hint.readout_s:
            views = at_middle_row(views, lens, velocity, self.hint.readout_s, views.xy)
        return _Tracked(tracked.path, views, velocity)

    def _frames(self, count: int) -> Iterator[Frame]:
        options = self._options
        last = options.start + count * options.stride
        end = last if options.end is None else min(last, options.end)
        return iter(self._stream.frames(options.start, end, options.stride))
