"""Assembly of a source from the contents of a recording: calibration, stereo pairs, ground truth.

A format lists its images as `Shot`s (each with a `StoredImage`, see
`vo.recordings.sources.images`), adds functions that read the calibration and the ground truth, and
passes this to `assemble`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import CalibrationError, NoCalibration, NoPairCalibration, SourceError, VoError
from vo.base.faults import Fault, FaultKind
from vo.base.frozen import frozen
from vo.base.geometry.cameras import equirectangular
from vo.base.geometry.rig_overlap import is_rig
from vo.base.types import Mode, Rig, Trajectory
from vo.recordings.formats.calibration import (
    Calibration,
    ImageSize,
    calibration_format,
    read_calibration,
)
from vo.recordings.formats.stamp_units import MAX_INTERVAL_NS, MIN_INTERVAL_NS
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.depth import UNITS_PER_METRE, DepthImages, associate_depth
from vo.recordings.sources.grey_levels import GreyLevels, find_grey_levels, seems_mosaic
from vo.recordings.sources.image_sizes import (
    check_size,
    first_image,
    rig_with_images,
    size_of,
    usual_size,
)
from vo.recordings.sources.images import Pixels, StoredImage
from vo.recordings.sources.imu import Imu
from vo.recordings.sources.listing import Shot, median_interval_ns
from vo.recordings.sources.orientation import warn_of_turned
from vo.recordings.sources.pairing import constant_offset_ns, pair_by_stamp, shifted
from vo.recordings.sources.panorama import is_panorama
from vo.recordings.sources.rig_frames import rig_frames
from vo.recordings.sources.sequence import ImageSequence, ListedImages
from vo.recordings.sources.series_content import warn_of_halves

_CALIBRATION_SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".conf", ".ini", ".txt")
_MAX_TRIED = 20
_log = logging.getLogger(__name__)


@frozen()
class RecordingContents:
    """Contents of a recording, as listed by its format.

    Attributes:
        left: images of cam0, with increasing stamps.
        right: images of cam1, with increasing stamps; None without a right camera.
        further: images of cam2, cam3 and so on, used if the calibration names them; None for a
            camera without images.
        calibrate: reads the calibration, given the size of the images.
        read_truth: reads the ground-truth poses of cam0, or returns None; may raise.
        close: closes the files that images keep open between reads.
        find_imus: lists the inertial sensors, the preferred one first, without reading their
            samples; its argument is the calibration, None if unknown.
        depth: depth images registered to cam0, with increasing stamps; None without depth.
        right_offset_ns: to be added to the stamps of `right`; None to find a constant offset.
    """

    name: str
    format: str
    left: Sequence[Shot]
    calibrate: Callable[[ImageSize], Calibration]
    right: Sequence[Shot] | None = None
    read_truth: Callable[[Calibration], Trajectory | None] = lambda _: None
    depth: Sequence[Shot] | None = None
    close: Callable[[], None] | None = None
    find_imus: Callable[[Calibration | None], Sequence[Imu]] = lambda _: ()
    right_offset_ns: int | None = None
    faults: Sequence[Fault] = ()
    further: Sequence[Sequence[Shot] | None] = ()
    film: Path | None = None  # a video file that has the images


def no_calibration(error: NoCalibration, is_pair: bool, mode: Mode) -> CalibrationError:
    """The error for one camera, or for a pair, which can be estimated with another option."""
    if not is_pair or mode == "mono":
        return error
    advice = "or the cameras' distance in metres, `camera.baseline_m=0.12`, to estimate them"
    return NoPairCalibration(f"{error}; {advice}")


def assemble(contents: RecordingContents, mode: Mode) -> ImageSequence:
    """Create a source, after checking that images and calibration match."""
    first = first_image(contents.left)
    size = size_of(first)
    warn_of_turned(contents.name, contents.left)
    if contents.right is None:
        warn_of_halves(contents.name, first)
    try:
        calibration = contents.calibrate(size)
    except NoCalibration as error:
        is_pair = contents.right is not None
        if is_pair or not is_panorama(contents.film, contents.left[0].image, size):
            raise no_calibration(error, is_pair, mode) from error
        _log.warning("%s: the images are marked as equirectangular (360°)", contents.name)
        calibration = Calibration(Rig(equirectangular(*size)))
    size = usual_size(contents.left, size, calibration.rig.cam0)
    check_size(calibration, calibration.rig.cam0, size, contents.left)
    rig = _choose_rig(contents, calibration, mode)
    if rig.further or (mode == "auto" and _are_apart(contents, rig)):
        return _assemble_rig(contents, calibration, rig, first)
    offset_ns = _right_offset(contents, rig)
    partners = _pair(contents, rig, mode, offset_ns)
    depth = None if partners else _depth(contents, calibration, mode)
    sequence = ImageSequence(
        name=contents.name,
        format=contents.format,
        rig=rig if partners else Rig(rig.cam0, has_depth=depth is not None),
        ground_truth=_truth(contents, calibration),
        images=ListedImages(
            contents.left, partners, _grey_levels(contents, first, partners), depth
        ),
        close=contents.close,
        imus=contents.find_imus(calibration),
    )
    _log.info(
        "%s: %d images of %dx%d, %s",
        contents.name,
        len(contents.left),
        *size,
        "stereo" if partners else "one camera",
    )
    sequence.faults += [*contents.faults, *_rate_faults(contents)]
    if partners:
        sequence.right_offset_ns = offset_ns
        if offset_ns and contents.right_offset_ns is None:
            found = Fault(FaultKind.RIGHT_TIME_OFFSET, is_handled=True, value=-1e-6 * offset_ns)
            sequence.faults.append(found)
    return sequence


def _are_apart(contents: RecordingContents, rig: Rig) -> bool:
    """Whether two cameras see nothing in common, by one clock: they are a rig, and no pair."""
    if rig.cam1 is None or not contents.right or contents.right_offset_ns is not None:
        return False
    if not is_rig(rig):
        return False
    interval_ns = median_interval_ns([shot.stamp_ns for shot in contents.left])
    return abs(constant_offset_ns(contents.left, contents.right)) <= interval_ns


def _assemble_rig(
    contents: RecordingContents, calibration: Calibration, rig: Rig, first: Pixels
) -> ImageSequence:
    """A source of any number of cameras, each of which may have its own stamps, and gaps."""
    found = rig_frames(contents.left, _others(contents)[: len(rig.cameras) - 1])
    frame_ns = np.array([shot.stamp_ns for shot in found.first], dtype=np.int64)
    times = np.stack([np.where(own < 0, frame_ns, own) for own in found.stamps_ns], axis=1)
    sequence = ImageSequence(
        name=contents.name,
        format=contents.format,
        rig=rig,
        ground_truth=_truth(contents, calibration),
        images=ListedImages(
            found.first,
            found.others[0],
            _grey_levels(contents, first, found.others[0]),
            further=found.others[1:],
            stamps_ns=list(map(tuple, times.tolist())) if found.is_staggered else None,
            camera_stamps_ns=found.stamps_ns,
        ),
        close=contents.close,
        imus=contents.find_imus(calibration),
    )
    sequence.faults += [*contents.faults, *_rate_faults(contents)]
    _log.info("%s: %d frames of %d cameras", contents.name, len(found.first), len(rig.cameras))
    return sequence


def _others(contents: RecordingContents) -> list[Sequence[Shot]]:
    """The images of cam1 and all further cameras."""
    return [shots or () for shots in (contents.right, *contents.further)]


def calibration_reader(
    chosen: Path | None, candidates: Sequence[Path]
) -> Callable[[ImageSize], Calibration]:
    """A function that reads the file chosen by the user, or else the first existing candidate."""

    def read(size: ImageSize) -> Calibration:
        existing = [path for path in candidates if path.is_file()]
        if chosen is None and not existing:
            looked_for = ", ".join(str(path) for path in candidates)
            found = _calibration_beside(candidates)
            advice = (
                "give one with `calibration=FILE` (format: docs/calibration.md)"
                if found is None
                else f"{found} is one: if it is that of these images, give `calibration={found}`"
            )
            kind = NoCalibration if found is None else CalibrationError
            raise kind(f"no calibration found; looked for {looked_for}; {advice}")
        return read_calibration(chosen or existing[0], size)

    return read


def _calibration_beside(candidates: Sequence[Path]) -> Path | None:
    """A calibration file of another name in the folders of the candidates, for advice."""
    folders = dict.fromkeys(path.parent for path in candidates)
    beside = [path for folder in folders if folder.is_dir() for path in sorted(folder.iterdir())]
    texts = [path for path in beside if path.suffix.lower() in _CALIBRATION_SUFFIXES]
    return next((path for path in texts[:_MAX_TRIED] if calibration_format(path)), None)


def first_existing(candidates: Sequence[Path]) -> Path | None:
    """The first candidate that exists, or None."""
    return next((path for path in candidates if path.is_file()), None)


def tum_truth(candidates: Sequence[Path]) -> Trajectory | None:
    """The poses in the first candidate that exists, in TUM's format."""
    file = first_existing(candidates)
    return None if file is None else read_tum(file)


def _grey_levels(
    contents: RecordingContents, first: Pixels, partners: Sequence[StoredImage | None] | None
) -> GreyLevels:
    """The conversion to 8 bits; what is not usual is reported."""
    if first.dtype == np.uint8 and not seems_mosaic(first):
        return GreyLevels(8)
    levels = find_grey_levels([shot.image for shot in contents.left], partners)
    if levels.are_swapped:
        _log.warning(
            "%s: the two bytes of the 16-bit values are stored in the wrong order, as neighbouring "
            "pixels show; they are exchanged",
            contents.name,
        )
    if levels.is_mosaic:
        _log.warning(
            "%s: pixels have alternating colour filters (a Bayer mosaic, not grey as stated), as "
            "pixels two apart are more alike than neighbours; they are averaged to grey",
            contents.name,
        )
    stretch = levels.stretch
    if stretch is not None:
        _log.warning(
            "%s: the images use only values from about %.0f to %.0f of %d bits; their contrast is "
            "stretched to 8 bits",
            contents.name,
            stretch.low.min(),
            stretch.high.max(),
            levels.bit_depth,
        )
    return levels


def _rate_faults(contents: RecordingContents) -> list[Fault]:
    """A rate of images that no camera for odometry has, as of stamps in another unit."""
    interval_ns = median_interval_ns([shot.stamp_ns for shot in contents.left])
    if not interval_ns or MIN_INTERVAL_NS <= interval_ns <= MAX_INTERVAL_NS:
        return []
    rate_hz = 1e9 / interval_ns
    _log.warning(
        "%s: by their stamps, images are %.3g s apart (%.3g Hz), which is implausible; are the "
        "stamps in another unit?",
        contents.name,
        1e-9 * interval_ns,
        rate_hz,
        extra=warning_kind("fault"),
    )
    return [Fault(FaultKind.IMPLAUSIBLE_RATE, is_handled=True, value=rate_hz)]


def _choose_rig(contents: RecordingContents, calibration: Calibration, mode: Mode) -> Rig:
    """The rig, with cam1 only if `mode` allows it and it has images and a calibration."""
    rig = calibration.rig
    if mode == "mono":
        return Rig(rig.cam0)
    if mode == "auto" and (many := rig_with_images(contents.name, calibration, _others(contents))):
        return many
    if not contents.right:
        if mode == "stereo":
            raise SourceError(
                f"{contents.name} has no images of a right camera; use `mode=mono` or add them"
            )
        return Rig(rig.cam0)
    rig = rig.first(2)
    if rig.cam1 is None:
        if mode == "stereo":
            raise CalibrationError(
                f"the calibration of {contents.name} has no right camera; add cam1 or use "
                "`mode=mono`"
            )
        _log.warning("%s: right images not used, because cam1 is not calibrated", contents.name)
        return Rig(rig.cam0)
    right_size = usual_size(contents.right, size_of(first_image(contents.right)), rig.cam1)
    check_size(calibration, rig.cam1, right_size, contents.right)
    return rig


def _right_offset(contents: RecordingContents, rig: Rig) -> int:
    """What to add to right stamps: as given, or else a constant offset, with a warning."""
    if contents.right_offset_ns is not None or rig.cam1 is None or not contents.right:
        return contents.right_offset_ns or 0
    offset_ns = constant_offset_ns(contents.left, contents.right)
    if offset_ns:
        _log.warning(
            "%s: right stamps are %+.3f ms from left ones in all pairs, and images are paired by "
            "that; `right_offset_ns` sets it",
            contents.name,
            -1e-6 * offset_ns,
            extra=warning_kind("fault"),
        )
    return offset_ns


def _pair(
    contents: RecordingContents, rig: Rig, mode: Mode, offset_ns: int
) -> list[StoredImage | None] | None:
    if rig.cam1 is None or not contents.right:
        return None
    partners = pair_by_stamp(contents.left, shifted(contents.right, offset_ns))
    if any(partners):
        return partners
    message = f"{contents.name}: no left image has a right image close enough in time"
    if mode == "stereo":
        raise SourceError(
            f"{message}; check the stamps, shift right ones by `right_offset_ns`, or use "
            "`mode=mono`"
        )
    _log.warning("%s; only the left camera is used (see `right_offset_ns`)", message)
    return None


def _depth(contents: RecordingContents, calibration: Calibration, mode: Mode) -> DepthImages | None:
    if mode == "mono" or not contents.depth:
        return None
    images = associate_depth(contents.left, contents.depth)
    if not any(images):
        _log.warning(
            "%s: depth not used, because no depth image is within 20 ms of an image", contents.name
        )
        return None
    return DepthImages(images, calibration.depth_per_metre or UNITS_PER_METRE)


def _truth(contents: RecordingContents, calibration: Calibration) -> Trajectory | None:
    """The ground truth; one that cannot be read only causes a warning."""
    try:
        return contents.read_truth(calibration)
    except (VoError, OSError, ValueError) as error:
        _log.warning("ground truth not used: %s", error)
        return None
