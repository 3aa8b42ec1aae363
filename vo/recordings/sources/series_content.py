"""Images of two cameras in one folder, or in each image, by what the images show."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Floats
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.images import ImageFile, Pixels

_log = logging.getLogger(__name__)
_SAMPLES = 5
_MIN_SIDE = 32  # pixels of images that have features
_WIDTH = 480
_FEATURES = 500
_MAX_DISTANCE = 48  # bits
_MIN_MATCHES = 30  # of images that show the same
_SEAM = 0.8  # of the matches from one image to the next
_ONE_DIRECTION = 0.9  # length of the mean of unit vectors
_WIDE, _TALL = 1.8, 0.95  # width by height of two images in one, and the opposite
_LEVEL_PX, _MOSTLY = 3.0, 0.6
_IN_TURN, _BACK = (
    7,
    0.5,
)  # images that are looked at; the part of each change of motion that is undone
_MIN_RATIO = 3.0  # of matches in a pair to those in images of other places


def compare_series(one: Sequence[Path], other: Sequence[Path]) -> bool | None:
    """Whether images of the same number show the same moment; None if neither is certain.

    If so, they match better than images of other moments of the recording, and what is seen moves
    less from one image of a series to the next than to the other series and back. In one camera's
    images that were counted in two parts, or two of each number, it does not.
    """
    count = min(len(one), len(other))
    rows = np.unique(np.linspace(0, count - 2, _SAMPLES).astype(int))
    pairs, steps, distant, sideways, onwards = [], [], [], [], []
    try:
        for row in rows:
            apart = (row + count // 2) % count
            features = [_features(path) for path in (one[row], other[row], one[row + 1])]
            pair, step = (_motions(features[0], each) for each in features[1:])
            pairs.append(len(pair))
            steps.append(len(step))
            distant.append(len(_motions(features[0], _features(one[apart]))))
            if len(pair) and len(step):
                sideways.append(np.median(pair, axis=0))
                onwards.append(np.median(step, axis=0))
        seam = len(_motions(_features(one[-1]), _features(other[0])))
    except SourceError:
        return False  # reported when the recording is read
    matches, chance = float(np.median(pairs)), float(np.median(distant))
    if matches < _MIN_MATCHES or matches < _MIN_RATIO * chance:
        is_elsewhere = matches < _MIN_MATCHES and np.median(steps) >= _MIN_RATIO * matches
        return False if is_elsewhere else None
    if seam >= _SEAM * np.median(steps):  # the second series goes on where the first one ends
        return None
    there, ahead = np.array(sideways), np.array(onwards)
    directions = there / np.maximum(np.linalg.norm(there, axis=1, keepdims=True), 1e-9)
    is_beside = np.linalg.norm(directions.mean(axis=0)) >= _ONE_DIRECTION
    is_pair = np.linalg.norm(ahead, axis=1).sum() < np.linalg.norm(2 * there - ahead, axis=1).sum()
    return True if is_pair and is_beside else None


_Features = tuple[Floats, "cv2.typing.MatLike | None"]


def warn_of_halves(name: str, image: Pixels) -> None:
    """Warn if both halves of an image show the same, as of a pair that is read as one camera.

    They are beside each other in a wide image, and one above the other in a tall one.
    """
    height, width = image.shape[:2]
    if _TALL * height < width < _WIDE * height:
        return  # of one camera, as usual
    is_wide = width > height
    one, other = np.array_split(image, [(width if is_wide else height) // 2], axis=int(is_wide))
    motions = _motions(_features_of(one), _features_of(other))
    is_level = len(motions) and np.mean(np.abs(motions[:, 1]) < _LEVEL_PX) > _MOSTLY
    if len(motions) >= 2 * _MIN_MATCHES and is_level:
        _log.warning(
            "%s: images seem to have those of a stereo pair %s, which are read as one: %s",
            name,
            "beside each other" if is_wide else "one above the other",
            "`side_by_side` reads them" if is_wide else "crop them",
            extra=warning_kind("calibration"),
        )


def warn_of_turns(images: Sequence[Path]) -> None:
    """Warn of images of two cameras in turn: what is seen goes to and fro from each to the next."""
    begins = {0, max(0, len(images) // 2 - _IN_TURN)}
    if len(images) >= _IN_TURN and all(_is_in_turn(images[n : n + _IN_TURN]) for n in begins):
        _log.warning(
            "%s: images seem to be of two cameras in turn, and are read as one: put every second "
            "one into a folder left, and the others into a folder right",
            images[0].parent,
            extra=warning_kind("calibration"),
        )


def _is_in_turn(images: Sequence[Path]) -> bool:
    before: _Features | None = None
    motion: Floats | None = None
    change: Floats | None = None
    for path in images:
        try:
            now = _features(path)
        except SourceError:
            return False  # reported when the recording is read
        motions = np.empty((0, 2)) if before is None else _motions(before, now)
        if before is not None and len(motions) < _MIN_MATCHES:
            return False
        last = motion
        motion = np.median(motions, axis=0) if len(motions) else None
        if last is not None and motion is not None:  # what moves steadily has no change
            last_change = change
            change = motion - last
            is_back = (
                last_change is None or change @ last_change < -_BACK * last_change @ last_change
            )
            if not is_back or np.linalg.norm(change) < _LEVEL_PX:
                return False
        before = now
    return True


def _features(path: Path) -> _Features:
    return _features_of(ImageFile(path).read())


def _features_of(image: Pixels) -> _Features:
    """Pixels (N, 2) and descriptors in a small copy of an image."""
    if min(image.shape[:2]) < _MIN_SIDE:
        return np.empty((0, 2)), None
    if image.dtype != np.uint8:
        image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U).astype(np.uint8)
    scale = min(1.0, _WIDTH / image.shape[1])
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    keypoints, descriptors = cv2.ORB.create(_FEATURES).detectAndCompute(image, None)
    return np.array([each.pt for each in keypoints], np.float64).reshape(-1, 2), descriptors


def _motions(one: _Features, other: _Features) -> Floats:
    """Motions in pixels (N, 2) of what is matched."""
    if one[1] is None or other[1] is None:
        return np.empty((0, 2))
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(one[1], other[1])
    near = [each for each in matches if each.distance <= _MAX_DISTANCE]
    pairs = [other[0][each.trainIdx] - one[0][each.queryIdx] for each in near]
    return np.array(pairs, np.float64).reshape(-1, 2)
