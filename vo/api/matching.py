"""`vo.match`: two images and what relates them."""

from __future__ import annotations

from collections.abc import Sequence, Set
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from vo.api.inputs import rig_of
from vo.base.config import Config, load_config
from vo.base.errors import CalibrationError, ConfigError
from vo.base.images.given_images import ColourOrder, grey_image, grey_mask, image_array
from vo.base.types import Bytes, Camera, Floats, Rig
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.sources.single_image import SingleImage, read_single_image
from vo.tools.pairs.image_pair import ImagePair, match_images
from vo.tools.pairs.pair_options import (
    PairChoices,
    check_cameras,
    pair_baseline,
    pair_cameras,
    pair_masks,
    pair_options,
    region_masks,
)
from vo.tools.pairs.stitching import panorama as stitched
from vo.tools.pairs.stitching import read_in_colour


class MatchOptions(PairChoices, total=False):
    """Options of `vo.match`, besides those of `PairChoices`.

    Attributes:
        right: the second image is of the right camera of the calibration.
        roi_a, roi_b: areas of one image to use, such as `["0,0,320,240"]`.
        masks: (H, W) bool or uint8 for each image, nonzero where features may lie, or None.
        colour: order of the channels of arrays in colour: `bgr` (OpenCV) or `rgb`.
    """

    right: bool
    masks: tuple[Any, Any]
    roi_a: Sequence[str]
    roi_b: Sequence[str]
    colour: ColourOrder


def match(
    a: Any,
    b: Any,
    config: Config | str | Path = "default",
    *,
    overrides: Sequence[str] = (),
    calibration: Calibration | Rig | Camera | Floats | str | Path | None = None,
    **options: Unpack[MatchOptions],
) -> ImagePair:
    """Match two images, and find the model and the motion between them, as `vo match` does.

    Args:
        a: (H, W) or (H, W, 3) array of uint8 or uint16, the path of an image, or
            `RECORDING:NUMBER`.
        b: the second image, perhaps of another size.
        config: `default`, `fast`, `accurate`, `best`, a YAML file, or a `vo.Config`.
        overrides: settings to change, such as `["features.count=2500"]`.
        calibration: of the camera of both images: a file, `vo.read_calibration(file)`, a `vo.Rig`,
            a `vo.Camera`, or a 3 x 3 matrix K of images without distortion; without one there is
            no motion, unless both are frames of recordings with a calibration.
        **options: detector, descriptor, matcher, ratio, cross_check, model, method, threshold_px
            (see `PairChoices`), right, masks, roi_a, roi_b and colour (see `MatchOptions`).

    Returns:
        Keypoints, matches, model, inliers and motion; `failure` where no model fits.

    Raises:
        InputError: an image is no array or path, or of the wrong type.
        SourceError: an image cannot be read.
        CalibrationError: the calibration cannot be read, or is for another image size.
        ConfigError: an option is unknown or invalid, or this build of OpenCV lacks it.
    """
    _check_names(options.keys())
    if not isinstance(config, Config):
        config = load_config(config, list(overrides))
    elif overrides:
        raise ConfigError("give overrides with the name of a preset or file, not with a Config")
    is_right, colour = options.pop("right", False), options.pop("colour", "bgr")
    masks = options.pop("masks", (None, None))
    if not isinstance(masks, tuple | list) or len(masks) != 2:
        raise ConfigError("masks are not two; give one for each image, or None")
    first = _image(a, "a", colour, right=False)
    second = _image(b, "b", colour, right=is_right)
    if isinstance(calibration, str | Path):
        height, width = first.image.shape
        calibration = read_calibration(calibration, (width, height))
    images = (first.image, second.image)
    cameras, baseline = _cameras(calibration, (first, second), right=is_right)
    check_cameras(cameras, images, (first.name, second.name))
    regions = (_areas(options.pop("roi_a", ())), _areas(options.pop("roi_b", ())))
    of_settings = region_masks(pair_masks(config, images, right=is_right), images, regions)
    one, other = map(_with, of_settings, masks, (first, second))
    choices: PairChoices = options
    return match_images(images, pair_options(config, choices, cameras, baseline), (one, other))


def _areas(given: Any) -> list[str]:
    return [given] if isinstance(given, str) else list(given)


def _cameras(
    calibration: Any, images: tuple[SingleImage, SingleImage], *, right: bool
) -> tuple[tuple[Camera, Camera] | None, Floats | None]:
    """The cameras of both images, and the motion of a calibrated pair, as far as they are known."""
    if isinstance(calibration, np.ndarray | list):
        first, second = (_ideal_camera(calibration, each.image) for each in images)
        return (first, second), None
    if isinstance(calibration, Camera):
        calibration = Rig(calibration)
    rig = None if calibration is None else rig_of(calibration, "auto", has_depth=False)
    cameras = pair_cameras(rig, (images[0].camera, images[1].camera), right=right)
    return cameras, pair_baseline(rig, images, right=right)


def _ideal_camera(matrix: Any, image: Bytes) -> Camera:
    """The camera of a matrix K."""
    try:
        k = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        k = np.empty(0)
    zeros = [] if k.shape != (3, 3) else [k[0, 1], k[1, 0], *k[2, :2], k[2, 2] - 1.0]
    if k.shape != (3, 3) or not np.isfinite(k).all() or any(zeros) or min(k[0, 0], k[1, 1]) <= 0:
        raise CalibrationError(
            "the calibration is no camera matrix; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in "
            "pixels (for lens distortion a vo.Camera or a file)"
        )
    height, width = image.shape
    fx, fy, cx, cy = (float(k[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(width, height, fx, fy, cx, cy)


def panorama(
    images: Sequence[Any],
    *,
    calibration: Calibration | Rig | Camera | str | Path | None = None,
    flat: bool = False,
) -> Bytes:
    """One picture (H, W, 3) BGR of overlapping images, as of `vo panorama`.

    Args:
        images: in order; (H, W) or (H, W, 3) BGR arrays of uint8, or paths.
        calibration: of the camera, whose lens distortion is removed.
        flat: the images show one plane from several places.

    Raises:
        InputError: the images do not fit together.
    """
    shots = [_in_colour(each, f"image {number}") for number, each in enumerate(images)]
    if isinstance(calibration, str | Path) and shots:
        height, width = shots[0].shape[:2]
        calibration = read_calibration(calibration, (width, height))
    if isinstance(calibration, Camera):
        calibration = Rig(calibration)
    camera = None
    if calibration is not None:
        camera = rig_of(calibration, "auto", has_depth=False).cam0
    names = [str(each) if isinstance(each, str | Path) else str(n) for n, each in enumerate(images)]
    for name, shot in zip(names, shots, strict=True):
        cameras = None if camera is None else (camera, camera)
        check_cameras(cameras, (shot[:, :, 0],) * 2, (name, name))
    return stitched(shots, names, camera, flat=flat)


def _in_colour(given: Any, name: str) -> Bytes:
    if isinstance(given, str | Path):
        return read_in_colour(given)
    image = image_array(given, name)
    if image.dtype == np.uint8 and image.ndim == 3:
        return np.ascontiguousarray(image[:, :, :3])
    return np.repeat(grey_image(given, name)[:, :, None], 3, axis=2)


def _check_names(given: Set[str]) -> None:
    known = MatchOptions.__annotations__.keys() | PairChoices.__annotations__.keys()
    unknown = sorted(given - known)
    if unknown:
        names = ", ".join(sorted(known))
        raise ConfigError(f"vo.match has no option '{unknown[0]}'; known: {names}")


def _with(mask: Bytes | None, given: Any, image: SingleImage) -> Bytes | None:
    """A mask of the settings and a given one together."""
    if given is None:
        return mask
    checked = grey_mask(given, f"mask of {image.name}", image.image.shape)
    return checked if mask is None else np.minimum(mask, checked)


def _image(given: Any, name: str, colour: ColourOrder, *, right: bool) -> SingleImage:
    if isinstance(given, str | Path):
        return read_single_image(given, right=right)
    return SingleImage(name, grey_image(given, name, colour))
