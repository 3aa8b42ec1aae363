"""Objects from images: their features, side by side, and whether they can be recognised at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import InputError
from vo.base.printable import printable
from vo.base.types import Bytes, Floats, Floats32
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.geometry.epipolar import transferred
from vo.tools.objects.appearance import thumbnail_of
from vo.tools.objects.confidence import THRESHOLD, flat_confidence
from vo.tools.objects.flat_verification import FlatInstance, flat_instances
from vo.tools.objects.part_matching import match_part, part_vectors
from vo.tools.objects.scene_features import (
    SceneFeatures,
    codes,
    compact,
    extract,
    strongest_of_each_size,
    unit_vectors,
)
from vo.tools.objects.stored_objects import Part, StoredObject
from vo.tools.pairs.simple_motions import inverse_matrix

MIN_SIDE_PX = 48
_MIN_FEATURES = 30
_MAX_NAME = 100  # characters
_MAX_WIDTH_M = 50.0
_MAX_PART_FEATURES = 2000
_TRIAL_TURN_DEG, _TRIAL_SCALE, _TRIAL_NOISE = 12.0, 0.8, 3.0
_TRIAL_MARGIN = 0.25  # of the image, grey around it


class Extractors(NamedTuple):
    """Of stored images and of scenes: alike but for the number of features."""

    stored: FeatureExtractor
    scene: FeatureExtractor


def make_object(
    name: str,
    images: Sequence[tuple[str, Bytes]],
    width_m: float | None,
    extractors: Extractors,
    centre: Floats32 | None,
) -> tuple[StoredObject, Floats32]:
    """An object, and the centre of the descriptors of its database.

    `images`: names for messages, and (H, W) uint8. `width_m`: of what the first image shows, None
    if it is not known. `centre`: of the descriptors of the database, None if this is its first
    object.

    Raises:
        InputError: it cannot be recognised, or a value is unusable.
    """
    check_name(name)
    if width_m is not None and not 0.0 < width_m <= _MAX_WIDTH_M:
        raise InputError(
            f"the width is {width_m:g} m; give metres, more than 0 and at most {_MAX_WIDTH_M:g}, "
            "such as 0.21"
        )
    if not images:
        raise InputError(f"object '{name}' has no image; give one or more")
    parts: list[Part] = []
    for image_name, image in images:
        found = _features(image_name, image, extractors.stored)
        if centre is None:
            centre = unit_vectors(compact(found.descriptor)).mean(axis=0)
        unit_m = width_m / image.shape[1] if width_m is not None and not parts else float("nan")
        part = _flat_part(found, image, unit_m, centre)
        _check_distinct(image_name, image, part, extractors.scene)
        known = _seen_before(image, parts, extractors.scene)
        if known is None:
            parts.append(part)
        else:
            number, instance = known
            parts[number] = _merged(parts[number], part, instance.homography)
    assert centre is not None
    return StoredObject(name, tuple(parts), len(images)), centre


def check_name(name: str) -> None:
    """Raise an InputError for a name that is empty, too long, or has control characters."""
    if not name.strip() or len(name) > _MAX_NAME or not name.isprintable():
        raise InputError(
            f"the name '{printable(name[:_MAX_NAME])}' is empty, longer than {_MAX_NAME} "
            "characters, or has control characters; choose another"
        )


def _features(name: str, image: Bytes, extractor: FeatureExtractor) -> SceneFeatures:
    height, width = image.shape
    if min(height, width) < MIN_SIDE_PX:
        raise InputError(
            f"{name} has {width}x{height} pixels; an object needs at least {MIN_SIDE_PX} on each "
            "side"
        )
    found = strongest_of_each_size(extract(extractor, image))
    places = len(np.unique(np.rint(found.xy / 3.0), axis=0))
    if places < _MIN_FEATURES:
        raise InputError(
            f"{name} has too little texture: features at {places} places, {_MIN_FEATURES} needed; "
            "take a sharper or larger image, or a side with print or a pattern"
        )
    return found


def _flat_part(found: SceneFeatures, image: Bytes, unit_m: float, centre: Floats32) -> Part:
    height, width = image.shape
    left, top = -0.5, -0.5
    right, bottom = width - 0.5, height - 0.5
    corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
    descriptor = compact(found.descriptor)
    return Part(
        found.xy.astype(np.float32),
        descriptor,
        codes(unit_vectors(descriptor), centre),
        found.angle,
        found.size.astype(np.float32),
        np.array(corners, np.float32),
        unit_m,
        thumbnail_of(image),
        (width, height),
    )


def _check_distinct(name: str, image: Bytes, part: Part, extractor: FeatureExtractor) -> None:
    """Refuse an image that is not recognised in a turned and smaller copy of itself."""
    copy, truth = _copy(image)
    best = _best(copy, part, extract(extractor, copy))
    corners = part.outline.astype(np.float64)
    size = float(np.hypot(*image.shape))
    if best is not None and best[0] >= THRESHOLD:
        away = np.linalg.norm(best[1].outline - transferred(truth, corners), axis=1)
        if float(away.max()) <= 0.05 * size:
            return
    raise InputError(
        f"{name} is not recognised even in a copy of itself: its texture repeats, or is too fine; "
        "take another side, or a sharper image"
    )


def _copy(image: Bytes) -> tuple[Bytes, Floats]:
    """The image turned, smaller, with noise, and the homography (3, 3) to it."""
    height, width = image.shape
    side = int(round(max(height, width) * (1.0 + 2.0 * _TRIAL_MARGIN)))
    middle = (width - 1) / 2.0, (height - 1) / 2.0
    affine = cv2.getRotationMatrix2D(middle, _TRIAL_TURN_DEG, _TRIAL_SCALE)
    affine[:, 2] += np.array([side - width, side - height]) / 2.0
    smooth = cv2.GaussianBlur(image, (0, 0), 0.6)
    copy = cv2.warpAffine(smooth, affine, (side, side), borderValue=128).astype(np.float64)
    copy += np.random.default_rng(0).normal(0.0, _TRIAL_NOISE, copy.shape)
    truth = np.vstack([affine, [0.0, 0.0, 1.0]])
    return np.clip(np.rint(copy), 0, 255).astype(np.uint8), truth


def _seen_before(
    image: Bytes, parts: Sequence[Part], extractor: FeatureExtractor
) -> tuple[int, FlatInstance] | None:
    """The number of the side that a further image shows, and the instance of it there."""
    if not parts:
        return None
    scene = extract(extractor, image)
    best = [(found, n) for n, part in enumerate(parts) if (found := _best(image, part, scene))]
    best = [pair for pair in best if pair[0][0] >= THRESHOLD]
    if not best:
        return None
    (_, instance), number = max(best, key=lambda pair: pair[0][0])
    return number, instance


def _best(image: Bytes, part: Part, scene: SceneFeatures) -> tuple[float, FlatInstance] | None:
    """The most confident instance of a side in an image."""
    vectors = part_vectors(part)
    found = [
        (flat_confidence(each.inliers, each.coverage, each.likeness), each)
        for each in flat_instances(image, scene, part, vectors, match_part(scene, vectors))
    ]
    return max(found, key=lambda pair: pair[0]) if found else None


def _merged(part: Part, other: Part, other_from_part: Floats) -> Part:
    """A side with the features of a further image of it, in its own pixels."""
    back = inverse_matrix(other_from_part)
    xy = other.xy.astype(np.float64)
    at = transferred(back, xy)
    step = transferred(back, xy + np.array([0.5, 0.0])) - at
    along = transferred(back, xy + np.array([0.0, 0.5])) - at
    zoom = 2.0 * np.sqrt(np.abs(step[:, 0] * along[:, 1] - step[:, 1] * along[:, 0]))
    turn = np.arctan2(step[:, 1] - along[:, 0], step[:, 0] + along[:, 1])
    width, height = part.image_size
    inside = ((at >= 0) & (at < (width, height))).all(axis=1) & np.isfinite(zoom) & (zoom > 0)
    rows = np.flatnonzero(inside)[: max(_MAX_PART_FEATURES - len(part.xy), 0)]
    return Part(
        np.concatenate([part.xy, at[rows].astype(np.float32)]),
        np.concatenate([part.descriptor, other.descriptor[rows]]),
        np.concatenate([part.code, other.code[rows]]),
        np.concatenate([part.angle, (other.angle[rows] + turn[rows]).astype(np.float32)]),
        np.concatenate([part.size, (other.size[rows] * zoom[rows]).astype(np.float32)]),
        part.outline,
        part.unit_m,
        part.thumbnail,
        part.image_size,
    )
