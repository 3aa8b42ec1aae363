"""`vo.match`: two images and what relates them."""

from __future__ import annotations

from collections.abc import Sequence, Set
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from vo.api.inputs import rig_of
from vo.base.config import Config, load_config
from vo.base.errors import ConfigError
from vo.base.images.given_images import ColourOrder, grey_image, grey_mask
from vo.base.types import Bytes, Rig
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.sources.single_image import SingleImage, read_single_image
from vo.tools.pairs.image_pair import ImagePair, match_images
from vo.tools.pairs.pair_options import (
    PairChoices,
    check_cameras,
    pair_cameras,
    pair_masks,
    pair_options,
)


class MatchOptions(PairChoices, total=False):
    """Options of `vo.match`, besides those of `PairChoices`.

    Attributes:
        right: the second image is of the right camera of the calibration.
        masks: (H, W) bool or uint8 for each image, nonzero where features may lie, or None.
        colour: order of the channels of arrays in colour: `bgr` (OpenCV) or `rgb`.
    """

    right: bool
    masks: tuple[Any, Any]
    colour: ColourOrder


def match(
    a: Any,
    b: Any,
    config: Config | str | Path = "default",
    *,
    overrides: Sequence[str] = (),
    calibration: Calibration | Rig | str | Path | None = None,
    **options: Unpack[MatchOptions],
) -> ImagePair:
    """Match two images, and find the model and the motion between them, as `vo match` does.

    Args:
        a: (H, W) or (H, W, 3) array of uint8 or uint16, the path of an image, or
            `RECORDING:NUMBER`.
        b: the second image, perhaps of another size.
        config: `default`, `fast`, `accurate`, a YAML file, or a `vo.Config`.
        overrides: settings to change, such as `["features.count=2500"]`.
        calibration: of the camera of both images; without one there is no motion, unless both are
            frames of recordings with a calibration.
        **options: detector, descriptor, matcher, ratio, cross_check, model, method, threshold_px
            (see `PairChoices`), right, masks and colour (see `MatchOptions`).

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
    rig = None if calibration is None else rig_of(calibration, "auto", has_depth=False)
    cameras = pair_cameras(rig, (first.camera, second.camera), right=is_right)
    images = (first.image, second.image)
    check_cameras(cameras, images, (first.name, second.name))
    one, other = (
        _with(of_settings, mask, each)
        for of_settings, mask, each in zip(
            pair_masks(config, images, right=is_right), masks, (first, second), strict=True
        )
    )
    choices: PairChoices = options
    return match_images(images, pair_options(config, choices, cameras), (one, other))


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
