"""Why a run is made again from its first frame: a sensor, lenses or a camera were not as taken."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from vo.base.config import Config, MasksConfig
from vo.base.faults import Fault, FaultKind
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.records.focal_length import MAX_SIGMA, FocalLength, focal_change
from vo.base.records.inertial_use import InertialUse
from vo.base.types import Estimate, Frame, Landmarks, Rig
from vo.engine.rig.creation import AnyOdometry
from vo.recordings.formats.warning_kinds import LoggedWarning
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.source import FrameStream, Recording
from vo.runs.run_options import RunOptions

# Lenses found to be wrong by more pixels at the image's edges have bent what was tracked before
# (KITTI 06: 0.085 m by 11 px; 0.026 by 7.6). Those of KITTI's drive of 2011 are, by 7 px at most.
_MIN_EDGE_PX = 8.0
_ZOOM = FaultKind.FOCAL_LENGTH_CHANGE
_WATCHED, _PER_SNAPSHOT = 45, 4  # keyframes that a calibration is checked by
_MIN_CONTRAST_RATIO = 3.0  # of right images to left ones


class TrackAgain(Exception):
    """All frames have to be tracked again, and all files are to be replaced."""

    def known_after(self, known: Known) -> Known:
        """What is known in the next pass."""
        return known


class InertialContradiction(TrackAgain):
    """A sensor contradicts the images: the run has to be made again without it.

    Attributes:
        use: the sensor, with the reason.
    """

    def __init__(self, use: InertialUse) -> None:
        super().__init__(f"{use.sensor}: {use.reason}")
        self.use = use


class LensesFound(TrackAgain):
    """Both lenses of a pair are wrong: the run has to be made again with what is known now.

    Attributes:
        k1: error of their first radial coefficient.
    """

    def __init__(self, k1: float, edge_px: float) -> None:
        super().__init__(f"both lenses are wrong by {edge_px:+.1f} px at the image's edges")
        self.k1 = k1

    def known_after(self, known: Known) -> Known:
        """See `TrackAgain.known_after`."""
        return known._replace(k1_error=self.k1)


class LeftCameraUseless(TrackAgain):
    """The left lens is fogged and the right one clear: the right camera has to track."""

    def __init__(self, frame: int) -> None:
        super().__init__(f"the left images are too faint, from frame {frame} on or before")

    def known_after(self, known: Known) -> Known:
        """See `TrackAgain.known_after`."""
        return known._replace(is_exchanged=True)


class WrongCalibration(TrackAgain):
    """The focal length of the only camera is another one: the stream has what was found.

    Attributes:
        found: the camera by the images.
        warning: for people.
    """

    def __init__(self, found: EstimatedCamera, given_px: float) -> None:
        super().__init__(f"the focal length is {found.focal_px:.1f} px, not {given_px:.1f}")
        self.found = found
        text = (
            f"the calibration is wrong: its focal length is {given_px:.1f} px, and by the images "
            f"the camera has: {found.in_words}; that was used, but calibrate again: vo calibrate"
        )
        self.warning = LoggedWarning(text, "calibration" if found.is_uncertain else None)

    def known_after(self, known: Known) -> Known:
        """See `TrackAgain.known_after`."""
        return known._replace(can_follow=False)


class FocalLengthChange(TrackAgain):
    """The focal length changes: images have to be brought to a constant one."""


class Known(NamedTuple):
    """What is known of a recording from earlier passes.

    Attributes:
        can_repeat: whether the frames can be read again.
        can_exchange: whether the cameras of a pair can change places.
        can_follow: whether a focal length that changes can be followed.
        k1_error: of both lenses.
        is_exchanged: whether they have changed places.
        focal_lengths: that were followed.
    """

    can_repeat: bool = False
    can_exchange: bool = False
    can_follow: bool = False
    k1_error: float = 0.0
    is_exchanged: bool = False
    focal_lengths: tuple[FocalLength, ...] = ()


def known_at_first(stream: FrameStream, config: Config, options: RunOptions) -> Known:
    """What is known before the first pass."""
    can_repeat = isinstance(stream, Recording) and not options.follow
    is_pair = len(stream.rig.cameras) == 2 and not stream.rig.has_depth
    # What describes images of camera 0: they would be those of the other one.
    files = {} if options.exports is None else options.exports.files
    is_bound = config.masks != MasksConfig() or options.save_map or any(files.values())
    is_usual = isinstance(stream, ImageSequence) and len(stream.rig.cameras) <= 2
    can_follow = can_repeat and is_usual and config.camera.focal != "constant"
    return Known(can_repeat, can_repeat and is_pair and not is_bound, can_follow)


def check_sensor(use: InertialUse | None, known: Known) -> None:
    """Raise InertialContradiction if there is one, and frames can be read a second time."""
    if use is not None and use.is_contradiction and known.can_repeat:
        raise InertialContradiction(use)


class Watched(Protocol):
    """A recording that was opened for a run, see `vo.runs.run_session.OpenedRun`."""

    @property
    def stream(self) -> FrameStream: ...  # noqa: D102
    @property
    def config(self) -> Config: ...  # noqa: D102
    @property
    def options(self) -> RunOptions: ...  # noqa: D102
    @property
    def known(self) -> Known: ...  # noqa: D102
    @property
    def estimated_camera(self) -> EstimatedCamera | None: ...  # noqa: D102


def watched(odometry: AnyOdometry, frames: Iterator[Frame], opened: Watched) -> Iterator[Estimate]:
    """Track all frames, unless they have to be tracked again: raises TrackAgain."""
    stream, known = opened.stream, opened.known
    watch = _CalibrationWatch(odometry, opened)
    can_exchange = known.can_exchange and not known.is_exchanged
    for estimate in odometry.track_all(frames):
        if known.can_repeat and known.k1_error == 0.0 and estimate.keyframes:
            _check_lenses(odometry, stream)
        watch.add(estimate)
        if known.can_follow and any(each.kind is _ZOOM for each in estimate.faults):
            watch.check()  # a wrong focal length, too, looks like another one
            raise FocalLengthChange("the focal length changes")
        if can_exchange and any(each.kind is FaultKind.FAINT_IMAGES for each in estimate.faults):
            can_exchange = False  # asked once
            if _is_left_fogged(stream, estimate.frame_index):
                raise LeftCameraUseless(estimate.frame_index)
        yield _of_other_camera(estimate) if known.is_exchanged else estimate
    watch.check()


class _CalibrationWatch:
    """Keyframes of one camera from when its lens was found to differ from its calibration."""

    def __init__(self, odometry: AnyOdometry, opened: Watched) -> None:
        self._odometry, self._opened = odometry, opened
        rig = opened.stream.rig
        is_one = len(rig.cameras) == 1 and not rig.has_depth
        self._is_on = is_one and opened.known.can_follow and opened.estimated_camera is None
        self._seen: list[tuple[Estimate, Landmarks | None]] = []

    def add(self, estimate: Estimate) -> None:
        """Raise WrongCalibration if enough keyframes say so."""
        errors = self._odometry.calibration_errors
        if not self._is_on or not estimate.keyframes or errors.lens_error is None:
            return
        # A snapshot has what all keyframes of the window observe.
        is_due = len(self._seen) % _PER_SNAPSHOT == 0
        landmarks = self._odometry.snapshot().landmarks if is_due else None
        self._seen.append((estimate, landmarks))
        if len(self._seen) >= _WATCHED:
            self.check()

    def check(self) -> None:
        """The same for those there are, once."""
        seen, self._is_on = self._seen if self._is_on else [], False
        if not seen:
            return
        from vo.runs.camera_estimation import corrected_camera  # seldom needed

        stream = self._opened.stream
        assert isinstance(stream, ImageSequence)
        found = corrected_camera(stream, self._opened.config, self._opened.options, seen)
        if found is not None:
            given_px = stream.rig.cam0.fx
            stream.rig = Rig(found[0])
            raise WrongCalibration(found[1], given_px)


def exchanged(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Frames of pairs whose cameras have changed places; a frame without a right image is lost."""
    for frame in frames:
        if frame.images[1] is not None:
            yield replace(frame, images=frame.images[::-1], path=None)


def _check_lenses(odometry: AnyOdometry, stream: FrameStream) -> None:
    error = odometry.calibration_errors.lens_error
    if error is not None and stream.rig.is_stereo and abs(error.edge_px) > _MIN_EDGE_PX:
        raise LensesFound(error.k1, error.edge_px)


def _is_left_fogged(stream: FrameStream, index: int) -> bool:
    """Whether a right image has several times the contrast of the left one."""
    for frame in stream.frames(index, index + 1):
        if frame.mask is not None or frame.stamps_ns is not None or stream.unpaired:
            return False
        left, right = (0.0 if i is None else float(np.std(i)) for i in frame.images[:2])
        return right > _MIN_CONTRAST_RATIO * left
    return False


def _of_other_camera(estimate: Estimate) -> Estimate:
    """An estimate that names the camera which has tracked alone as it is mounted."""
    left, right = FaultKind.LEFT_CAMERA_ALONE, FaultKind.RIGHT_CAMERA_ALONE
    faults = tuple(f._replace(kind=right) if f.kind is left else f for f in estimate.faults)
    return replace(estimate, faults=faults)


def zoom_faults(found: tuple[FocalLength, ...]) -> list[Fault]:
    """The fault of a focal length that was followed, if it was; handled if it is exact."""
    if not found:
        return []
    is_exact = all(each.sigma_px < MAX_SIGMA * each.focal_px for each in found)
    return [Fault(FaultKind.FOCAL_LENGTH_CHANGE, is_exact, focal_change(found))]
