"""One picture of several images: two by their homography, or a panorama."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path

import cv2
import numpy as np

from vo.base.config import load_config
from vo.base.errors import ConfigError, InputError
from vo.base.geometry.cameras import distort
from vo.base.types import Bytes, Camera, Floats
from vo.recordings.sources.grey_levels import find_grey_levels
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.single_image import read_single_image
from vo.tools.drawing import write_picture
from vo.tools.pairs.image_pair import ImagePair, PairMatcher, PairOptions
from vo.tools.pairs.turned_views import compose, find_turns
from vo.tools.pairs.two_view_records import ModelKind

_log = logging.getLogger(__name__)
_MAX_SIDE = 4  # of a warped picture, in those of its images
_MOVED = (
    "the camera moved between the images: near things may be doubled or cut; turn the camera in "
    "one place"
)
_FAILURES = {
    cv2.Stitcher_ERR_NEED_MORE_IMGS: "the images do not overlap enough",
    cv2.Stitcher_ERR_HOMOGRAPHY_EST_FAIL: "no homographies connect the images",
    cv2.Stitcher_ERR_CAMERA_PARAMS_ADJUST_FAIL: "no common focal length and rotations fit",
}


def read_in_colour(given: str | Path) -> Bytes:
    """An image (H, W, 3) BGR of 8 bits; a frame of a recording (`RECORDING:NUMBER`) in grey."""
    grey = read_single_image(given).image
    stored = ImageFile(Path(given))
    if Path(given).exists():
        image = find_grey_levels([stored]).to_8_bits(stored.read(colour=True), 0)
        grey = np.asarray(image, dtype=np.uint8)
    if grey.ndim == 3:
        return grey
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def undistorted(image: Bytes, camera: Camera | None) -> Bytes:
    """The image that the ideal camera of the same matrix sees; black beyond the recorded one."""
    if camera is None or not camera.is_distorted:
        return image
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.column_stack(
        [(u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy]
    )
    at = np.nan_to_num(distort(camera, rays), nan=-1e3).reshape(*u.shape, 2).astype(np.float32)
    return np.asarray(cv2.remap(image, at, None, cv2.INTER_LINEAR), dtype=np.uint8)


def write_warped(path: Path, images: tuple[Bytes, Bytes], pair: ImagePair) -> None:
    """Draw the first image as the second sees it, in one picture with it: the mean where both are.

    `path`: PNG or JPEG file. `images`: (H, W, 3) BGR. `pair`: with a homography.

    Raises:
        ConfigError: there is no homography, or it enlarges the first image beyond reason.
        OutputError: the file cannot be written.
    """
    if pair.fit is None or pair.fit.kind is not ModelKind.HOMOGRAPHY:
        raise ConfigError("images are warped by a homography; give `model=h`")
    first, second = map(undistorted, images, pair.cameras or (None, None))
    write_picture(path, _warped(first, second, pair.fit.matrix))


def _warped(first: Bytes, second: Bytes, homography: Floats) -> Bytes:
    (h1, w1), (h2, w2) = first.shape[:2], second.shape[:2]
    corners = np.array([[0, 0, 1], [w1, 0, 1], [w1, h1, 1], [0, h1, 1]]) @ homography.T
    if corners[:, 2].min() <= 1e-6 * abs(corners[:, 2]).max():
        raise ConfigError("the first image reaches to infinity in the second, and is not warped")
    xy = corners[:, :2] / corners[:, 2:]
    low = np.floor(np.minimum(xy.min(axis=0), 0)).astype(int)
    high = np.ceil(np.maximum(xy.max(axis=0), (w2, h2))).astype(int)
    width, height = (high - low).tolist()
    if max(width / max(w1, w2), height / max(h1, h2)) > _MAX_SIDE:
        raise ConfigError(
            f"the warped picture would have {width} x {height} pixels; the images are seen from "
            "too different directions"
        )
    shift = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1]], dtype=np.float64)

    def placed(image: Bytes, matrix: Floats) -> tuple[Floats, Floats]:
        ones = np.ones(image.shape[:2], np.float32)
        there = cv2.warpPerspective(ones, matrix, (width, height))
        return (
            np.asarray(cv2.warpPerspective(image, matrix, (width, height)), dtype=np.float64),
            np.asarray(there > 0.99, dtype=np.float64)[:, :, None],
        )

    (one, has_one), (other, has_other) = placed(first, shift @ homography), placed(second, shift)
    mean = (one * has_one + other * has_other) / np.maximum(has_one + has_other, 1.0)
    return np.asarray(np.rint(mean), dtype=np.uint8)


def panorama(
    images: Sequence[Bytes], names: Sequence[str], camera: Camera | None, *, flat: bool = False
) -> Bytes:
    """One picture (H, W, 3) BGR of images that were taken from one place.

    By the rotations of a known camera, otherwise by OpenCV's stitching, which guesses the focal
    length. A warning says so if the camera was moved.

    `images`: (H, W, 3) BGR. `camera`: None if unknown. `flat`: a plane seen from several places
    instead, such as a page or the ground.

    Raises:
        InputError: less than two images, or they do not fit together.
    """
    if len(images) < 2:
        raise InputError("a panorama is made of two images or more")
    images = [undistorted(image, camera) for image in images]
    options = PairOptions(load_config("default", ["features.detector=sift"]))
    if camera is not None and not flat:
        views = find_turns(images, camera, options)
        _warn_of(names, views.rotations, _MOVED if views.camera_moved else "")
        used_images = {number: images[number] for number in views.rotations}
        return compose(used_images, views.rotations, camera)
    cv2.setRNGSeed(0)
    stitcher = cv2.Stitcher.create(cv2.Stitcher_SCANS if flat else cv2.Stitcher_PANORAMA)
    try:
        status, picture = stitcher.stitch(images)
    except cv2.error as error:  # such as a picture of more pixels than memory has
        raise InputError(f"the images cannot be stitched: {error.err}") from error
    if status != cv2.Stitcher_OK or picture is None:
        reason = _FAILURES.get(status, "they do not fit together")
        raise InputError(f"no panorama: {reason}; give images in order that overlap by a third")
    used = [int(number) for number in np.ravel(stitcher.component())]
    moved = not flat and _has_parallax([images[number] for number in used], options)
    _warn_of(names, used, f"{_MOVED}, or give its `calibration`" if moved else "")
    return np.asarray(picture, dtype=np.uint8)


def _has_parallax(images: Sequence[Bytes], options: PairOptions) -> bool:
    """Whether neighbours are better explained by a moved camera than by a turned one."""
    matcher = PairMatcher(options)
    features = [matcher.extract(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) for image in images]
    pairs = [matcher.match(*two) for two in zip(features, features[1:], strict=False)]
    moved = [pair for pair in pairs if pair.fit and pair.fit.kind is not ModelKind.HOMOGRAPHY]
    return 2 * len(moved) > len(pairs)


def _warn_of(names: Sequence[str], used: Collection[int], more: str) -> None:
    left_out = [name for number, name in enumerate(names) if number not in used]
    if left_out:
        _log.warning("left out, as they fit to no other: %s", ", ".join(left_out))
    if more:
        _log.warning("%s", more)
