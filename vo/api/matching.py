"""`vo.match`: two images and what relates them, and all of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import Any, Unpack, cast, get_type_hints

import numpy as np

from vo.api.inputs import rig_of
from vo.api.run_words import MaskWords, take_settings
from vo.base.config import Config, load_config
from vo.base.errors import CalibrationError, ConfigError
from vo.base.images.given_images import ColourOrder, grey_image, grey_mask, image_array
from vo.base.types import Bytes, Camera, Floats, Rig
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.sources.listing import list_images
from vo.recordings.sources.single_image import SingleImage, read_single_image
from vo.tools.drawing import check_picture
from vo.tools.pairs.image_pair import ImagePair, match_images
from vo.tools.pairs.image_set import PairCounts, image_set, match_set
from vo.tools.pairs.match_files import check_match_files, match_files
from vo.tools.pairs.pair_options import (
    PairChoices,
    check_cameras,
    pair_baseline,
    pair_cameras,
    pair_masks,
    pair_options,
    region_masks,
)
from vo.tools.pairs.pair_picture import write_pair_picture
from vo.tools.pairs.stitching import panorama as stitched
from vo.tools.pairs.stitching import read_in_colour, write_warped


class FolderOptions(PairChoices, MaskWords, total=False):
    """Options of `vo.match_folder`: those of `PairChoices`, and masks as of `vo.run`."""


class MatchOptions(FolderOptions, total=False):
    """Options of `vo.match`, besides those of `FolderOptions`.

    Attributes:
        right: the second image is of the right camera of the calibration.
        roi_a, roi_b: areas of one image to use, such as `["0,0,320,240"]`.
        masks: (H, W) bool or uint8 for each image, nonzero where features may lie, or None.
        colour: order of the channels of arrays in colour: `bgr` (OpenCV) or `rgb`.
        picture: file for both images with their matches (.png, .jpg); of them the `best` ones,
            with `epipolar` lines.
        warp: file for the first image as the second sees it, by the homography.
    """

    right: bool
    masks: tuple[Any, Any]
    roi_a: Sequence[str]
    roi_b: Sequence[str]
    colour: ColourOrder
    picture: str | Path | None
    best: int | None
    epipolar: bool
    warp: str | Path | None


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
            (see `PairChoices`), mask, ignore, roi, and those of `MatchOptions`.

    Returns:
        Keypoints, matches, model, inliers and motion; `failure` where no model fits.

    Raises:
        InputError: an image is no array or path, or of the wrong type.
        SourceError: an image cannot be read.
        CalibrationError: the calibration cannot be read, or is for another image size.
        ConfigError: an option is unknown or invalid, or this build of OpenCV lacks it.
    """
    _check_names(options.keys(), MatchOptions)
    config = _settings(config, overrides, options)
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
    drawn = _pictures(options)
    if drawn["warp"] is not None:
        options["model"] = "h"
    choices = pair_options(config, _choices(options), cameras, baseline)
    found = match_images(images, choices, (one, other))
    _draw(drawn, (a, b), images, found)
    return found


def _pictures(options: Any) -> dict[str, Any]:
    """What is to be drawn, which is taken out of the options."""
    drawn = {name: options.pop(name, None) for name in ("picture", "best", "epipolar", "warp")}
    for name in ("picture", "warp"):
        if drawn[name] is not None:
            check_picture(Path(drawn[name]))
    for name in ("best", "epipolar"):
        if drawn[name] and drawn["picture"] is None:
            raise ConfigError(f"`{name}` needs `picture=FILE`, where the lines are drawn")
    best = drawn["best"]
    if best is not None and (not isinstance(best, int) or best < 1):
        raise ConfigError(f"`best` is {best!r}; give a number of matches from 1")
    if drawn["warp"] is not None and options.get("model") not in (None, "auto", "h"):
        raise ConfigError("`warp` needs a homography; leave `model` out, or give `model=h`")
    return drawn


def _draw(
    drawn: dict[str, Any], given: tuple[Any, Any], images: tuple[Bytes, Bytes], found: ImagePair
) -> None:
    if drawn["picture"] is not None:
        epipolar, best = bool(drawn["epipolar"]), drawn["best"]
        write_pair_picture(Path(drawn["picture"]), images, found, epipolar=epipolar, best=best)
    if drawn["warp"] is not None and found.fit is not None:
        first, second = (_in_colour(each, "image") for each in given)
        write_warped(Path(drawn["warp"]), (first, second), found)


def match_folder(
    folder: str | Path,
    config: Config | str | Path = "default",
    *,
    overrides: Sequence[str] = (),
    calibration: Calibration | Rig | Camera | Floats | str | Path | None = None,
    pairs: str | Path | Sequence[tuple[str, str]] | None = None,
    window: int | None = None,
    output: str | Path | Sequence[str | Path] = (),
    **options: Unpack[FolderOptions],
) -> list[PairCounts]:
    """Match pairs of the images of a folder, as `vo match DIR` does, and count.

    Args:
        folder: with images of one camera.
        config: see `match`, as for overrides, calibration and options.
        overrides: settings to change.
        calibration: of the camera.
        pairs: names of two images each, or a text file with two in each line; all if missing.
        window: of all pairs, those at most so many images apart in the order of their names.
        output: files for keypoints, matches and models (.csv, .npz, .h5, .db of COLMAP).
        **options: those of `FolderOptions`.

    Raises:
        SourceError: less than two images can be read, or the list of pairs cannot be.
        OutputError: a file cannot be written.
        ConfigError, CalibrationError: see `match`.
    """
    _check_names(options.keys(), FolderOptions)
    if window is not None and (not isinstance(window, int) or window < 1):
        raise ConfigError(f"`window` is {window!r}; give a number of images from 1")
    folder, listed = Path(folder), Path(pairs) if isinstance(pairs, str) else pairs
    outputs = [Path(each) for each in ([output] if isinstance(output, str | Path) else output)]
    check_match_files(outputs)
    inputs = [each for each in (listed, calibration) if isinstance(each, str | Path)]
    refuse_to_overwrite([folder, *map(Path, inputs)], outputs)
    settings = _settings(config, overrides, options)
    images = image_set(folder, listed, window)
    cameras = None
    if calibration is not None:
        first = _image(list_images(folder)[0], "a", "bgr", right=False)
        if isinstance(calibration, str | Path):
            height, width = first.image.shape
            calibration = read_calibration(calibration, (width, height))
        cameras, _ = _cameras(calibration, (first, first), right=False)
    with match_files(outputs) as files:
        return match_set(images, pair_options(settings, _choices(options), cameras), files)


def _choices(options: Mapping[str, Any]) -> PairChoices:
    return cast(PairChoices, options)


def _settings(config: Config | str | Path, overrides: Sequence[str], options: Any) -> Config:
    """The settings, with those of the options, which are taken out of them."""
    changes = [*overrides, *take_settings(options)]
    if not isinstance(config, Config):
        return load_config(config, changes)
    if changes:
        raise ConfigError("give overrides with the name of a preset or file, not with a Config")
    return config


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


def _check_names(given: Set[str], options: type) -> None:
    known = get_type_hints(options).keys()
    unknown = sorted(given - known)
    if unknown:
        names = ", ".join(sorted(known))
        function = "vo.match" if options is MatchOptions else "vo.match_folder"
        raise ConfigError(f"{function} has no option '{unknown[0]}'; known: {names}")


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
