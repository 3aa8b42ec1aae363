"""From the lists that a format gathered to a source: size, calibration, mode, pairs, truth.

A format lists its images as `Shot`s, whatever they are stored in (`StoredImage` in
`vo.sources.images`), says how to get the calibration and the truth, and hands this to `assemble`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.errors import CalibrationError, SourceError, VoError
from vo.formats.calibration import Calibration, ImageSize, read_calibration
from vo.sources.depth import UNITS_PER_METRE, DepthImages, depth_of_each
from vo.sources.images import Pixels, StoredImage, depth_bits_of
from vo.sources.imu import Imu
from vo.sources.listing import Shot
from vo.sources.pairing import pair_by_stamp
from vo.sources.sequence import ImageSequence, ListedImages
from vo.types import Camera, Mode, Rig, Trajectory

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Gathered:
    """What a format found in a folder or file.

    Attributes:
        name: short name of the recording.
        format: name of the format in the registry.
        left: the images of cam0, stamps increasing.
        right: those of cam1, stamps increasing; None where there are none.
        calibrate: reads the calibration, given the size of the images.
        read_truth: reads the poses of cam0, or gives None; it may fail.
        close: closes what images keep open between reads.
        find_imus: lists the inertial sensors, the one to use first, without reading them; the
            calibration may be unknown.
        depth: depth images at the pixels of cam0, stamps increasing; None where there are none.
    """

    name: str
    format: str
    left: Sequence[Shot]
    right: Sequence[Shot] | None
    calibrate: Callable[[ImageSize], Calibration]
    read_truth: Callable[[Calibration], Trajectory | None]
    depth: Sequence[Shot] | None = None
    close: Callable[[], None] | None = None
    find_imus: Callable[[Calibration | None], Sequence[Imu]] = lambda _: ()


def assemble(gathered: Gathered, mode: Mode) -> ImageSequence:
    """Check that images and calibration fit together and make a source of them.

    Raises:
        SourceError: no image can be read, or `mode` is stereo and there is no right camera.
        CalibrationError: the calibration is missing, wrong, or for images of another size.
    """
    first = _first_image(gathered.left)
    size = _size_of(first)
    calibration = gathered.calibrate(size)
    _check_size(calibration, calibration.rig.cam0, size, gathered.left)
    rig = _choose_rig(gathered, calibration, mode)
    partners = _pair(gathered, rig, mode)
    depth = None if partners else _depth(gathered, calibration, mode)
    images = [shot.image for shot in gathered.left]
    return ImageSequence(
        name=gathered.name,
        format=gathered.format,
        rig=rig if partners else Rig(rig.cam0, has_depth=depth is not None),
        ground_truth=_truth(gathered, calibration),
        images=ListedImages(
            gathered.left,
            partners,
            8 if first.dtype == np.uint8 else depth_bits_of(images),
            depth,
        ),
        close=gathered.close,
        imus=gathered.find_imus(calibration),
    )


def find_calibration(
    chosen: Path | None, candidates: Sequence[Path]
) -> Callable[[ImageSize], Calibration]:
    """A reader of the file that the user chose, or of the first candidate that exists."""

    def read(size: ImageSize) -> Calibration:
        existing = [path for path in candidates if path.is_file()]
        if chosen is None and not existing:
            looked_for = ", ".join(str(path) for path in candidates)
            raise CalibrationError(
                f"no calibration found; looked for {looked_for}; give one with --calibration FILE "
                "(docs/calibration.md shows what it looks like)"
            )
        return read_calibration(chosen or existing[0], size)

    return read


def first_existing(candidates: Sequence[Path]) -> Path | None:
    """The first of some files that exists."""
    return next((path for path in candidates if path.is_file()), None)


def _first_image(shots: Sequence[Shot]) -> Pixels:
    """The first that can be read."""
    reason = ""
    for shot in shots:
        try:
            return shot.image.read()
        except SourceError as error:
            reason = reason or str(error)
    raise SourceError(f"none of {len(shots)} images can be read; the first: {reason}")


def _size_of(image: Pixels) -> ImageSize:
    height, width = image.shape
    return width, height


def _check_size(
    calibration: Calibration, camera: Camera, size: ImageSize, shots: Sequence[Shot]
) -> None:
    if (camera.width, camera.height) == size:
        return
    found = f" {calibration.file} ({calibration.kind})" if calibration.file else " found with them"
    raise CalibrationError(
        f"images such as {shots[0].image.name} are {size[0]}x{size[1]}, but the calibration{found} "
        f"is for {camera.width}x{camera.height}; give one for images of this very size with "
        "--calibration FILE (if they were resized, scale fx, fy, cx and cy of it as well)"
    )


def _choose_rig(gathered: Gathered, calibration: Calibration, mode: Mode) -> Rig:
    """The rig with cam1 only if it is wanted, has images and is calibrated."""
    rig = calibration.rig
    if mode == "mono":
        return Rig(rig.cam0)
    if not gathered.right:
        if mode == "stereo":
            raise SourceError(
                f"{gathered.name} has no images of a right camera; use --mode mono or add them"
            )
        return Rig(rig.cam0)
    if rig.cam1 is None:
        if mode == "stereo":
            raise CalibrationError(
                f"the calibration of {gathered.name} has no right camera; add cam1 or use "
                "--mode mono"
            )
        _log.warning("%s: right images not used, as cam1 is not calibrated", gathered.name)
        return Rig(rig.cam0)
    _check_size(calibration, rig.cam1, _size_of(_first_image(gathered.right)), gathered.right)
    return rig


def _pair(gathered: Gathered, rig: Rig, mode: Mode) -> list[StoredImage | None] | None:
    if rig.cam1 is None or not gathered.right:
        return None
    partners = pair_by_stamp(gathered.left, gathered.right)
    if any(partners):
        return partners
    message = f"{gathered.name}: no left image has a right one close enough in time"
    if mode == "stereo":
        raise SourceError(f"{message}; check the stamps or use --mode mono")
    _log.warning("%s; only the left camera is used", message)
    return None


def _depth(gathered: Gathered, calibration: Calibration, mode: Mode) -> DepthImages | None:
    if mode == "mono" or not gathered.depth:
        return None
    images = depth_of_each(gathered.left, gathered.depth)
    if not any(images):
        _log.warning(
            "%s: depth not used, as no depth image is within 20 ms of an image", gathered.name
        )
        return None
    return DepthImages(images, calibration.depth_per_metre or UNITS_PER_METRE)


def _truth(gathered: Gathered, calibration: Calibration) -> Trajectory | None:
    """The ground truth; a broken one is warned of, as the run does not need it."""
    try:
        return gathered.read_truth(calibration)
    except (VoError, OSError, ValueError) as error:
        _log.warning("ground truth not used: %s", error)
        return None
