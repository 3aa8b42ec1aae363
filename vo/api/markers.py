"""`vo.find_markers`: markers in an image, with their poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vo.api.inputs import rig_of
from vo.base.errors import CalibrationError, ConfigError
from vo.base.images.given_images import ColourOrder, grey_image
from vo.base.types import Camera, Rig
from vo.engine.markers.dictionaries import dictionary_name
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.sources.single_image import read_single_image
from vo.tools.markers.boards import check_length
from vo.tools.markers.detection import Refinement, make_detector
from vo.tools.markers.image_markers import Marker
from vo.tools.markers.search import MarkerFinder


def find_markers(
    image: Any,
    length_m: float | None = None,
    *,
    calibration: Calibration | Camera | Rig | str | Path | None = None,
    dictionary: str = "auto",
    refinement: str = "lines",
    colour: ColourOrder = "bgr",
) -> tuple[Marker, ...]:
    """Find ArUco or AprilTag markers and their poses, as `vo markers` does.

    Args:
        image: (H, W) or (H, W, 3) array of uint8 or uint16, the path of an image, or
            `RECORDING:NUMBER`.
        length_m: side of the black square in metres; None for no poses.
        calibration: of the camera; by default that of the recording. Without one there are no
            poses.
        dictionary: such as `tag36h11` or `4X4_50`; `auto`: the one that the image shows.
        refinement: of the corners: `lines`, `subpix`, `apriltag` or `none`.
        colour: order of the channels of an array in colour: `bgr` (OpenCV) or `rgb`.

    Returns:
        By increasing id; empty where no marker is visible.

    Raises:
        InputError: the image is no array or path, or of the wrong type.
        SourceError: it cannot be read.
        CalibrationError: the calibration cannot be read, or is for another image size.
        ConfigError: an option is invalid, or `auto` finds two dictionaries that fit equally.
    """
    if length_m is not None:
        check_length(length_m)
    if refinement not in list(Refinement):
        raise ConfigError(f"refinement is '{refinement}'; use one of {', '.join(Refinement)}")
    name = dictionary_name(dictionary)
    camera: Camera | None = None
    if isinstance(image, str | Path):
        given = read_single_image(image)
        grey, camera = given.image, given.camera
    else:
        grey = grey_image(image, "image", colour)
    height, width = grey.shape
    if isinstance(calibration, str | Path):
        calibration = read_calibration(calibration, (width, height))
    if isinstance(calibration, Camera):
        camera = calibration
    elif calibration is not None:
        camera = rig_of(calibration, "auto", has_depth=False).cam0
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"the calibration is for images of {camera.width} x {camera.height}, and the image is "
            f"{width} x {height}"
        )
    detector = make_detector(name, Refinement(refinement), [grey], "the image")
    if detector is None:
        return ()
    return MarkerFinder(detector, length_m, camera).find(grey).markers
