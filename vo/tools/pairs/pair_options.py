"""Options for two images from single choices, checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict, get_args

import numpy as np

from vo.base.config import Config, MatchingName
from vo.base.errors import CalibrationError, ConfigError
from vo.base.images.given_images import shown
from vo.base.images.image_areas import split_cameras
from vo.base.settings import nearest, validate
from vo.base.types import Bytes, Camera, Floats, Rig
from vo.engine.frontend.static_masks import recorded_masks
from vo.recordings.sources.single_image import SingleImage
from vo.tools.pairs.image_pair import ModelName, PairOptions
from vo.tools.pairs.two_view_records import FitOptions, RobustMethod

MATCHERS = (*get_args(MatchingName), "gms")
"""Values of `PairChoices.matcher`."""


class PairChoices(TypedDict, total=False):
    """Choices for two images; None or a missing one leaves the settings as they are."""

    detector: str | None  # value of `features.detector`
    descriptor: str | None  # value of `features.descriptor`
    matcher: str | None  # value of `matching.method`, or `gms`
    ratio: float | None  # value of `matching.ratio`
    cross_check: bool | None  # value of `matching.cross_check`
    model: str | None  # `auto`, `f`, `e` or `h`
    method: str | None
    threshold_px: float | None


def pair_options(
    config: Config,
    choices: PairChoices,
    cameras: tuple[Camera, Camera] | None,
    baseline: Floats | None = None,
) -> PairOptions:
    """The options for `match_images`.

    `config`: settings, changed by the choices. `cameras`: of both images, None if they are unknown.
    `baseline`: second_from_first (4, 4) of a calibrated pair.

    Raises:
        ConfigError: a choice is unknown or out of range.
    """
    sections = config.model_dump()
    matcher = choices.get("matcher")
    is_gms = matcher == "gms"
    changes = {
        ("features", "detector"): choices.get("detector"),
        ("features", "descriptor"): choices.get("descriptor"),
        ("matching", "method"): None if is_gms else matcher,
        ("matching", "ratio"): choices.get("ratio"),
        ("matching", "cross_check"): choices.get("cross_check"),
    }
    for (section, key), value in changes.items():
        if value is not None:
            sections[section][key] = value
    model = choices.get("model") or "auto"
    method = choices.get("method") or FitOptions().method
    _check("model", model, get_args(ModelName))
    _check("method", method, get_args(RobustMethod))
    if model == "e" and cameras is None:
        raise ConfigError("an essential matrix needs the calibration of both cameras; give it")
    threshold_px = choices.get("threshold_px")
    if threshold_px is None:
        threshold_px = FitOptions().threshold_px
    if not isinstance(threshold_px, int | float) or not 0.0 < threshold_px <= 100.0:
        raise ConfigError(
            f"the threshold is {shown(threshold_px)} px; give more than 0, at most 100"
        )
    return PairOptions(
        validate(Config, sections, "the options"),
        is_gms,
        model,  # type: ignore[arg-type]
        FitOptions(method, float(threshold_px), seed=config.seed),  # type: ignore[arg-type]
        cameras,
        baseline,
    )


def pair_cameras(
    rig: Rig | None, own: tuple[Camera | None, Camera | None], *, right: bool
) -> tuple[Camera, Camera] | None:
    """The cameras of two images, None if they are unknown.

    `rig`: of a calibration that was given. `own`: calibrations that the images bring along, used
    without a given one. `right`: whether the second image is of the right camera.

    Raises:
        CalibrationError: the right camera is not known.
    """
    if rig is None:
        if right and own[1] is None:
            raise CalibrationError(
                "the second image is a right one of an unknown camera; give its calibration"
            )
        return None if own[0] is None or own[1] is None else (own[0], own[1])
    if not right:
        return rig.cam0, rig.cam0
    if rig.cam1 is None:
        raise CalibrationError("the second image is a right one, but the calibration has no cam1")
    return rig.cam0, rig.cam1


def pair_baseline(
    rig: Rig | None, images: tuple[SingleImage, SingleImage], *, right: bool
) -> Floats | None:
    """second_from_first (4, 4) of a left and a right image; None if it is not known.

    `rig`: of a calibration that was given. Frames of a recording at different times have none.
    """
    first, second = images
    rig = second.rig if rig is None else rig
    if not right or rig is None or first.frame != second.frame:
        return None
    return rig.cam1_from_cam0


def pair_masks(
    config: Config, images: tuple[Bytes, Bytes], *, right: bool
) -> tuple[Bytes | None, Bytes | None]:
    """Masks (H, W) that the settings give for two images, 0 where no feature may lie.

    `config`: settings, of which `masks` is used. `right`: whether the second image is of the right
    camera; otherwise both are of the left one.

    Raises:
        ConfigError: a mask is missing, damaged or of another size, or nothing is left.
    """
    if not right:
        return image_mask(config, images[0]), image_mask(config, images[1])
    first, second = (_any_camera(image) for image in images)
    of_second = recorded_masks(config.masks, Rig(first, second, np.eye(4)))[1]
    return image_mask(config, images[0]), of_second


def image_mask(config: Config, image: Bytes) -> Bytes | None:
    """The mask (H, W) that the settings give for an image of the left camera, None without one."""
    return recorded_masks(config.masks, Rig(_any_camera(image)))[0]


def region_masks(
    masks: tuple[Bytes | None, Bytes | None],
    images: tuple[Bytes, Bytes],
    regions: tuple[Sequence[str], Sequence[str]],
) -> tuple[Bytes | None, Bytes | None]:
    """The masks (H, W) that also leave out what is outside of the regions of each image.

    Raises:
        ConfigError: a region is no area, or outside of its image.
    """

    def limited(mask: Bytes | None, image: Bytes, texts: Sequence[str]) -> Bytes | None:
        if not texts:
            return mask
        for text in texts:
            if split_cameras(text)[0] is not None:
                raise ConfigError(f"'{text}' names a camera; the region is of one image, without")
        config = validate(Config, {"masks": {"roi": texts}}, "the region")
        region = image_mask(config, image)
        return region if mask is None or region is None else np.minimum(mask, region)

    one, other = map(limited, masks, images, regions)
    return one, other


def _any_camera(image: Bytes) -> Camera:
    """A camera of which only the size is used."""
    height, width = image.shape
    return Camera(width, height, 1.0, 1.0, 0.0, 0.0)


def check_cameras(
    cameras: tuple[Camera, Camera] | None, images: tuple[Bytes, Bytes], names: tuple[str, str]
) -> None:
    """Check that images have the size that their cameras are calibrated for.

    Raises:
        CalibrationError: one of them has not.
    """
    for camera, image, name in zip(cameras or (), images, names, strict=False):
        height, width = image.shape
        if (width, height) != (camera.width, camera.height):
            raise CalibrationError(
                f"{name} has {width}x{height} pixels, the calibration is for "
                f"{camera.width}x{camera.height}; give images as calibrated"
            )


def _check(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ConfigError(
            f"there is no {what} {shown(value)}; known: {', '.join(known)}"
            f"{nearest(str(value), known)}"
        )
