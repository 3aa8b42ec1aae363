"""Check that images have the size of their calibrated cameras."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress

from vo.base.errors import CalibrationError, SourceError
from vo.base.printable import counted
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration import Calibration, ImageSize
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.listing import Shot

_log = logging.getLogger(__name__)


def first_image(shots: Sequence[Shot]) -> Pixels:
    """The first image that can be read."""
    reason = ""
    for shot in shots:
        try:
            return shot.image.read()
        except SourceError as error:
            reason = reason or str(error)
    raise SourceError(f"none of {len(shots)} images can be read; first error: {reason}")


def size_of(image: Pixels) -> ImageSize:
    """Width and height."""
    height, width = image.shape
    return width, height


def usual_size(shots: Sequence[Shot], size: ImageSize, camera: Camera) -> ImageSize:
    """The size of the calibration if most images have it, though the first one has another."""
    calibrated = camera.width, camera.height
    if size == calibrated:
        return size
    sizes = []
    for number in {1, len(shots) // 2, len(shots) - 1} - {0, len(shots)}:
        with suppress(SourceError):
            sizes.append(size_of(shots[number].image.read()))
    return calibrated if 2 * sizes.count(calibrated) > len(sizes) else size


def check_size(
    calibration: Calibration, camera: Camera, size: ImageSize, shots: Sequence[Shot]
) -> None:
    """Refuse a calibration of another size than that of the images."""
    if (camera.width, camera.height) == size:
        return
    file = f" {calibration.file} ({calibration.kind})" if calibration.file else " of the recording"
    advice = (
        "it seems to be that of images turned by 90 degrees; give that of the images as stored"
        if (camera.height, camera.width) == size
        else "give a calibration for this image size with `calibration=FILE` (for resized images, "
        "scale its fx, fy, cx and cy as well)"
    )
    raise CalibrationError(
        f"images such as {shots[0].image.name} are {size[0]}x{size[1]}, but the calibration{file} "
        f"is for {camera.width}x{camera.height}; {advice}"
    )


def rig_with_images(
    name: str, calibration: Calibration, images: Sequence[Sequence[Shot]]
) -> Rig | None:
    """The calibrated cameras up to the last one with images; None if these are no more than two.

    `images`: those of cam1, cam2 and so on, perhaps none.
    """
    rig = calibration.rig
    if not rig.further and not any(images[1:]):
        return None
    count = max((number for number, shots in enumerate(images, start=1) if shots), default=0) + 1
    if count > len(rig.cameras):
        _log.warning(
            "%s: images of cam%d%s are not used, because the calibration has only %s",
            name,
            len(rig.cameras),
            f" to cam{count - 1}" if count > len(rig.cameras) + 1 else "",
            counted(len(rig.cameras), "camera"),
        )
    elif 2 < count < len(rig.cameras):
        left_out = len(rig.cameras) - count
        _log.warning(
            "%s: the calibration has %d cameras, but %s",
            name,
            len(rig.cameras),
            f"the last {left_out} have no images" if left_out > 1 else "the last has no images",
        )
    many = rig.first(count)
    if not many.further:
        return None
    for number, camera in enumerate(many.cameras[1:], start=1):
        shots = images[number - 1]
        if not shots:
            _log.warning(
                "%s: there are no images of cam%d, which is calibrated; it is not used",
                name,
                number,
            )
        else:
            size = usual_size(shots, size_of(first_image(shots)), camera)
            check_size(calibration, camera, size, shots)
    return many
