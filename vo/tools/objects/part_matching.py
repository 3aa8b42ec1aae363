"""Matches of a scene with a side of a stored object; many of the scene may match one of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bools, Floats, Floats32, Ints
from vo.tools.objects.agreement import best_agreement, moves
from vo.tools.objects.scene_features import SceneFeatures, unit_vectors
from vo.tools.objects.stored_objects import Part

_SAME_PLACE = 0.015  # of the size of a part: features so near to each other are of one place
_MAX_RATIO = 0.72  # of squared distances of the nearest and the nearest of another place
_PLACE_PX = 3.0  # several matches of a place so large count once as they move alike


class PartMatches(NamedTuple):
    """Matches; rows belong together."""

    scene: Ints  # (n,) rows of the scene's features
    part: Ints  # (n,) rows of the part's features; one may occur several times
    ratio: Floats  # (n,) squared distance relative to that of another place; lower is better

    def select(self, rows: Ints | Bools) -> PartMatches:
        """Some of them."""
        return PartMatches(self.scene[rows], self.part[rows], self.ratio[rows])


class PartVectors(NamedTuple):
    """A part as it is matched; rows belong together."""

    vector: Floats32  # (N, width) unit vectors
    xy: Floats32  # (N, 2) pixels of the stored image
    angle: Floats32  # (N,) radians, NaN without orientation
    size: Floats32  # (N,) relative to the smallest features
    same: Bools  # (N, N) which features are at the same place


def part_vectors(part: Part) -> PartVectors:
    """Prepare a part for matching."""
    xy = part.xy
    size = float(np.ptp(xy, axis=0).max()) if len(xy) else 0.0
    near = [np.abs(each[:, None] - each[None]) <= _SAME_PLACE * size for each in xy.T]
    same = near[0] & near[1]
    return PartVectors(unit_vectors(part.descriptor), xy, part.angle, part.size, same)


def match_part(scene: SceneFeatures, part: PartVectors) -> PartMatches:
    """The nearest feature of the part for each of the scene that has clearly one.

    Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004, sec. 7.1;
    the second-nearest is the nearest at another place of the part.
    """
    if not len(scene) or not len(part.vector):
        empty = np.zeros(0, np.int64)
        return PartMatches(empty, empty, np.zeros(0))
    likeness = scene.vector @ part.vector.T
    nearest = likeness.argmax(axis=1)
    ratio: Floats = _ratios(likeness, nearest, part.same)
    good = np.flatnonzero(ratio <= _MAX_RATIO)
    return PartMatches(good, nearest[good].astype(np.int64), ratio[good])


@compiled
def _ratios(likeness, nearest, same):  # type: ignore[no-untyped-def]
    """(n,) squared distances of the nearest relative to those of the nearest at another place.

    `likeness`: (n, N) scalar products of unit vectors. `nearest`: (n,) columns of the largest ones.
    `same`: (N, N) which columns are of the same place.
    """
    ratio = np.empty(len(likeness), dtype=np.float64)
    for n in range(len(likeness)):
        second = np.float32(-1.0)
        for k in range(likeness.shape[1]):
            if likeness[n, k] > second and not same[nearest[n], k]:
                second = likeness[n, k]
        ratio[n] = (1.0 - likeness[n, nearest[n]]) / max(1.0 - second, 1e-6)
    return ratio


def common_motion(scene: SceneFeatures, part: PartVectors, matches: PartMatches) -> Ints | None:
    """Rows of the matches of most places that move alike; None if features have no orientation."""
    rows, columns = matches.scene, matches.part
    first = part.xy[columns], part.angle[columns], part.size[columns]
    second = scene.xy[rows], scene.angle[rows], scene.size[rows]
    if not len(rows) or not np.isfinite(first[1]).all() or not np.isfinite(second[1]).all():
        return None
    _, place = np.unique(np.rint(first[0] / _PLACE_PX), axis=0, return_inverse=True)
    return np.flatnonzero(best_agreement(moves(first, second), place.ravel()))
