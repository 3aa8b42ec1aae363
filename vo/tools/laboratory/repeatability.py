"""Repeatability of features whose places in the other image are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.scheduling import one_opencv_thread
from vo.base.types import Bools, Bytes, Floats, Floats32, Ints
from vo.tools.laboratory.images import PlanePair, read_homography, read_image
from vo.tools.laboratory.methods import Method, PairMatches
from vo.tools.pairs.two_view_fit import fit_homography
from vo.tools.pairs.two_view_records import Fit

CORRECT_PX = 2.0
"""Largest distance of a correct match from its true place or epipolar line."""

_DEPTH_RATIO = 0.05  # difference of depths beyond which something else hides a point
_CHUNK = 256  # features whose distances to all others are computed together

Transfer = Callable[[Floats], Floats]
"""Takes pixels (N, 2) of one image to the other; NaN where they are not visible there."""


class Transfers(NamedTuple):
    """Ways from the first image to the second and back."""

    forward: Transfer
    backward: Transfer


ACCURACIES_PX = (1.0, 3.0, 5.0)
"""Corner errors below which a homography counts, as is usual on HPatches."""


class PlaneScore(NamedTuple):
    """What a method reached on two images of a plane, or on several pairs: then means."""

    method: str
    features: tuple[int, int]  # in the first and in the second image
    matches: int
    repeatability: float  # ratio of features that are found again
    matching_score: float  # correct matches by features of the common part, of the image with fewer
    precision: float  # ratio of matches that are correct
    extract_ms: float  # CPU time of detection and description, per image
    match_ms: float  # CPU time of matching
    # Mean distance of the corners by the estimated homography from the true ones, of several pairs
    # the median; infinite without one
    corner_px: float
    within_1_px: float  # ratio of pairs with a corner error up to this
    within_3_px: float
    within_5_px: float
    pairs: int = 1


def score_plane(method: Method, first: Bytes, second: Bytes, homography: Floats) -> PlaneScore:
    """Score a method on two images (H, W) uint8 of a plane.

    Source: Mikolajczyk and Schmid, "A performance evaluation of local descriptors", PAMI 2005.

    `method`: finds features and matches. `second`: the second image; it may have another size.
    `homography`: second_from_first (3, 3), invertible.
    """
    found = method.match(first, second)
    transfers = by_homography(homography, first.shape, second.shape)
    detected = method.detect(first), method.detect(second)
    correct = correct_by_homography(found, homography)
    common = min(
        np.count_nonzero(np.isfinite(transfers.forward(detected[0])[:, 0])),
        np.count_nonzero(np.isfinite(transfers.backward(detected[1])[:, 0])),
    )
    matches = len(found.first)
    return PlaneScore(
        method.name,
        (len(detected[0]), len(detected[1])),
        matches,
        repeatability(*detected, transfers),
        min(correct / common, 1.0) if common else 0.0,
        correct / matches if matches else 0.0,
        found.extract_ms / 2.0,
        found.match_ms,
        *_accuracy(found, homography, first.shape),
    )


def score_planes(
    methods: Sequence[Method],
    pairs: Sequence[PlanePair],
    progress: Callable[[str], None] = lambda _: None,
) -> list[PlaneScore]:
    """Score methods on pairs of images of a plane, in one thread; means of all pairs.

    `progress`: called with the name of a method before each pair.

    Raises:
        SourceError: an image or a homography cannot be read.
    """
    scores: dict[str, list[PlaneScore]] = {method.name: [] for method in methods}
    with one_opencv_thread():
        for number, pair in enumerate(pairs):
            homography = read_homography(pair.homography)
            first, second = (read_image(path).pixels for path in (pair.first, pair.second))
            for method in methods:
                progress(method.name)
                if number == 0:
                    method.match(first, first)  # what is loaded at first use
                scores[method.name].append(score_plane(method, first, second, homography))
    return [mean_score(of_one) for of_one in scores.values()]


def mean_score(scores: Sequence[PlaneScore]) -> PlaneScore:
    """The score of a method on several pairs."""
    columns = {name: [getattr(score, name) for score in scores] for name in PlaneScore._fields}
    means = {name: float(np.mean(columns[name])) for name in PlaneScore._fields[3:-1]}
    first, second = (round(float(np.mean(side))) for side in zip(*columns["features"], strict=True))
    means["corner_px"] = float(np.median(columns["corner_px"]))
    matches = round(float(np.mean(columns["matches"])))
    return PlaneScore(scores[0].method, (first, second), matches, **means, pairs=len(scores))


def _accuracy(
    found: PairMatches, homography: Floats, shape: tuple[int, ...]
) -> tuple[float, float, float, float]:
    """Corner error in pixels, and whether it is within each of the usual limits.

    Source: DeTone, Malisiewicz, Rabinovich, "SuperPoint", CVPRW 2018, section 7.3.
    """
    fit = fit_homography(found.first, found.second)
    error = float("inf")
    if isinstance(fit, Fit):
        height, width = shape[:2]
        corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]])
        away = transferred(corners, fit.matrix) - transferred(corners, homography)
        error = float(np.mean(np.linalg.norm(away, axis=1)))
    one, three, five = (float(error <= limit) for limit in ACCURACIES_PX)
    return error, one, three, five


def by_homography(
    second_from_first: Floats, first: tuple[int, ...], second: tuple[int, ...]
) -> Transfers:
    """Transfers of a plane.

    `second_from_first`: (3, 3) homography. `first`: shape (H, W) of the first image. `second`:
    shape of the second image.
    """
    back = np.asarray(np.linalg.inv(second_from_first), dtype=np.float64)
    return Transfers(
        lambda xy: _visible(transferred(xy, second_from_first), second),
        lambda xy: _visible(transferred(xy, back), first),
    )


def by_depth(
    depths: tuple[Floats32, Floats32], second_from_first: Floats, camera: RectifiedRig
) -> Transfers:
    """Transfers of points with known depth.

    `depths`: (H, W) metres at the pixels of both images, 0 where unknown. `second_from_first`: (4,
    4) true motion.
    """
    first, second = depths
    back = inverse(second_from_first)
    return Transfers(
        lambda xy: _moved(xy, first, second, second_from_first, camera),
        lambda xy: _moved(xy, second, first, back, camera),
    )


def repeatability(first: Floats, second: Floats, transfers: Transfers) -> float:
    """Ratio of places of features (N, 2), (M, 2) that are found again.

    Features at the same place, such as those of SIFT with two orientations, are one. A place counts
    if the other image sees it; it is repeated if it and a place of the other image are nearest to
    each other there, and within 2 pixels.

    Source: Mikolajczyk et al., "A comparison of affine region detectors", IJCV 2005, section 4.
    """
    first, second = np.unique(first, axis=0), np.unique(second, axis=0)
    there, back = transfers.forward(first), transfers.backward(second)
    there = there[np.isfinite(there).all(axis=1)]
    second = second[np.isfinite(back).all(axis=1)]
    fewer = min(len(there), len(second))
    if fewer == 0:
        return 0.0
    nearest, distance = _nearest(there, second)
    backward, _ = _nearest(second, there)
    is_mutual = backward[nearest] == np.arange(len(there))
    return float(np.count_nonzero(is_mutual & (distance <= CORRECT_PX)) / fewer)


def correct_by_homography(found: PairMatches, second_from_first: Floats) -> int:
    """Number of matches within 2 pixels of where a homography (3, 3) takes them."""
    away = np.linalg.norm(transferred(found.first, second_from_first) - found.second, axis=1)
    return int(np.count_nonzero(away <= CORRECT_PX))


def transferred(xy: Floats, homography: Floats) -> Floats:
    """Pixels (N, 2) moved by a homography (3, 3); NaN or infinite where it has no image."""
    mapped = np.column_stack([xy, np.ones(len(xy))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _moved(
    xy: Floats, depth: Floats32, other: Floats32, other_from_this: Floats, camera: RectifiedRig
) -> Floats:
    """Pixels (N, 2) in the other image; NaN without depth, outside, or behind something else."""
    z = _at(depth, xy)
    points = camera.back_project(camera.undistort(xy), np.where(z > 0, z, np.nan))
    points = points @ other_from_this[:3, :3].T + other_from_this[:3, 3]
    points[~(points[:, 2] > 0)] = np.nan
    there = _visible(camera.distort(camera.project(points)), other.shape)
    seen = _at(other, there)
    is_hidden = ~(np.abs(seen - points[:, 2]) <= _DEPTH_RATIO * points[:, 2])
    there[is_hidden] = np.nan
    return there


def _at(depth: Floats32, xy: Floats) -> Floats:
    """(N,) depth at the nearest pixels; 0 for pixels that are NaN."""
    inside = np.isfinite(xy).all(axis=1)
    result = np.zeros(len(xy))
    u, v = np.rint(xy[inside]).astype(np.int64).T
    height, width = depth.shape
    result[inside] = depth[v.clip(0, height - 1), u.clip(0, width - 1)]
    return result


def _visible(xy: Floats, shape: tuple[int, ...]) -> Floats:
    """Pixels (N, 2); NaN outside an image of shape (H, W)."""
    return np.where(_inside(xy, shape)[:, None], xy, np.nan)


def _inside(xy: Floats, shape: tuple[int, ...]) -> Bools:
    return np.asarray(((xy >= 0) & (xy <= [shape[1] - 1, shape[0] - 1])).all(axis=1))


def _nearest(xy: Floats, others: Floats) -> tuple[Ints, Floats]:
    """For each point (N, 2), the row of the nearest of the others (M, 2) and its distance."""
    rows, distances = [], []
    for begin in range(0, len(xy), _CHUNK):
        away = np.linalg.norm(xy[begin : begin + _CHUNK, None] - others[None], axis=2)
        rows.append(away.argmin(axis=1))
        distances.append(away.min(axis=1))
    return np.concatenate(rows).astype(np.int64), np.concatenate(distances)
