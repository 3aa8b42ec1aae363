"""The place of a path in a map of markers, by the markers of both.

Of marker m, whose pose is (R_m, t_m) in the world of the path and (S_m, u_m) in the map, a
similarity from the world to the map (scale s, rotation Q, translation q) leaves the residuals

    s Q t_m + q - u_m    and    log(Q R_m S_m^T),

in standard deviations of both. The sides of the markers have given the path its metres already, so
log s is 0 with the standard deviation of that scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import make_transform, rotation_angle, skew, so3_exp, so3_log
from vo.base.types import Bools, Floats
from vo.engine.markers.marker_problem import square_points
from vo.tools.markers.marker_map import KnownMarker
from vo.tools.markers.scale_fit import RegisteredMarker

_ROUNDS = 8
_ALL_PAIRS = 24  # markers, up to which all pairs are tried
# A marker fits if it is within this distance, and this part of that to the ones it is placed by.
_MAX_ERROR_M, _MAX_ERROR_RATIO = 0.03, 0.03
_MAX_TURN = np.deg2rad(20.0)
_MAP_TURN = np.deg2rad(1.0)  # standard deviation of the orientation of a marker in a map
_DRIFT_RATIO = 0.005  # of the path from one marker to another, of their distance
_SIZE_SIGMA = 0.003  # relative, of the path itself, as for single markers
_MIN_SCALE_ERROR = 0.03  # of the map against the sides of markers, which is not reported
_MAX_SIGMAS = 3.0
_FIXED = 1e-9  # relative standard deviation of a scale that is given


class MapFit(NamedTuple):
    """What a map says about the scale of a world, and which markers agree."""

    scale: float  # metres of the map in a metre by the sides of the markers
    relative_sigma: float
    used: tuple[int, ...]
    # Distance in metres from where the map has them, of those that do not, by id
    refused: Mapping[int, float]
    contradicts_sides: bool  # whether the distances of the map contradict the sides of the markers


class MapPose(NamedTuple):
    """Where a world in metres is in a map."""

    map_from_world: Floats  # (4, 4)
    sigma_m: float  # standard deviation of the position, where the markers are
    sigma_rad: float  # standard deviation of the rotation


def fit_map(
    markers: Sequence[RegisteredMarker], known: Mapping[int, KnownMarker], scale_sigma: float
) -> MapFit | str:
    """The scale by the distances between markers, of the markers that agree with each other.

    `markers`: of a world, in metres by their sides, all of them known. `scale_sigma`: relative
    standard deviation of these metres.

    Returns why not, in words after the name of the map, if most of them do not agree.
    """
    both = _Pairs.of(markers, known)
    agree = _consensus(both, scale_sigma)
    if agree is None:
        return _contradiction(both)
    agree = _without_others(both, agree, scale_sigma)
    found = _refine(both.of_rows(agree), scale_sigma)
    off = _distances(both, found)[0]
    return MapFit(
        found.scale,
        float(np.hypot(np.sqrt(found.covariance[6, 6]), _SIZE_SIGMA)),
        tuple(both.ids[row] for row in np.flatnonzero(agree).tolist()),
        {both.ids[row]: float(off[row]) for row in np.flatnonzero(~agree).tolist()},
        abs(np.log(found.scale)) > max(_MIN_SCALE_ERROR, _MAX_SIGMAS * scale_sigma),
    )


def register_in_map(
    markers: Sequence[RegisteredMarker], known: Mapping[int, KnownMarker]
) -> MapPose:
    """Register a world, in the metres of its path, by markers that agree."""
    found = _refine(_Pairs.of(markers, known), _FIXED)
    sigmas = np.sqrt(np.diag(found.covariance))
    return MapPose(
        make_transform(found.rotation, found.translation),
        float(np.linalg.norm(sigmas[3:6])),
        float(np.linalg.norm(sigmas[:3])),
    )


class _Pairs(NamedTuple):
    """Markers in the world and in the map, row by row."""

    ids: tuple[int, ...]
    world: Floats  # (M, 4, 4)
    map: Floats  # (M, 4, 4)
    sigma_m: Floats  # (M,)
    sigma_rad: Floats  # (M,)
    lengths: Floats  # (M,)

    @staticmethod
    def of(markers: Sequence[RegisteredMarker], known: Mapping[int, KnownMarker]) -> _Pairs:
        mapped = [known[marker.id] for marker in markers]
        per_axis = np.array([marker.sigma_m for marker in markers]) / np.sqrt(3.0)
        turn = np.array([marker.sigma_rad for marker in markers]) / np.sqrt(3.0)
        return _Pairs(
            tuple(marker.id for marker in markers),
            np.stack([marker.world_from_marker for marker in markers]),
            np.stack([each.map_from_marker for each in mapped]),
            np.hypot(per_axis, [each.sigma_m for each in mapped]),
            np.hypot(turn, _MAP_TURN),
            np.array([each.length_m for each in mapped]),
        )

    def of_rows(self, rows: Bools) -> _Pairs:
        ids = tuple(number for number, used in zip(self.ids, rows, strict=True) if used)
        return _Pairs(ids, *(values[rows] for values in self[1:]))

    def corners(self, row: int) -> tuple[Floats, Floats]:
        points = square_points(float(self.lengths[row]))
        world, mapped = self.world[row], self.map[row]
        return (
            points @ world[:3, :3].T + world[:3, 3],
            points @ mapped[:3, :3].T + mapped[:3, 3],
        )


class _Solution(NamedTuple):
    rotation: Floats
    translation: Floats
    scale: float
    covariance: Floats  # (7, 7): rotation, position of the middle, log of the scale
    cost: float  # squared residuals in standard deviations, that of the scale included


def _consensus(both: _Pairs, scale_sigma: float) -> Bools | None:
    """The markers that agree with one or two of them, if they are the majority.

    Two of three or more markers give a scale of their own, so that its error does not hide that of
    a marker.
    """
    count = len(both.ids)
    has_scale = count > 2
    largest = max(_MIN_SCALE_ERROR, _MAX_SIGMAS * scale_sigma)
    ratio = _MAX_ERROR_RATIO + (0.0 if has_scale else _MAX_SIGMAS * scale_sigma)
    best: tuple[int, float] | None = None
    chosen = np.zeros(count, dtype=bool)
    for rows in _samples(count):
        corners = [both.corners(row) for row in rows]
        source, target = (np.concatenate(each) for each in zip(*corners, strict=True))
        guess = umeyama(source, target, with_scale=has_scale)
        if guess.scale <= 0.0 or abs(np.log(guess.scale)) > largest:
            continue
        placed = _Solution(guess.rotation, guess.translation, guess.scale, np.zeros((7, 7)), 0.0)
        off, turned = _distances(both, placed)
        middle = both.map[list(rows), :3, 3].mean(axis=0)
        limit = _MAX_ERROR_M + ratio * np.linalg.norm(both.map[:, :3, 3] - middle, axis=1)
        agree = (off <= limit) & (turned <= _MAX_TURN)
        score = int(agree.sum()), -float(np.minimum(off / limit, 1.0).sum())
        if best is None or score > best:
            best, chosen = score, agree
    return chosen if 2 * chosen.sum() > count else None


def _without_others(both: _Pairs, agree: Bools, scale_sigma: float) -> Bools:
    """Leave out markers that the others contradict, the one first whose loss helps most."""
    while agree.sum() > 2 and 2 * (agree.sum() - 1) > len(agree):
        cost, out, is_off = np.inf, -1, False
        for row in np.flatnonzero(agree).tolist():
            rest = agree.copy()
            rest[row] = False
            found = _refine(both.of_rows(rest), scale_sigma)
            if found.cost < cost:
                reach = both.map[row, :3, 3] - both.map[rest, :3, 3].mean(axis=0)
                limit = _MAX_ERROR_M + _MAX_ERROR_RATIO * float(np.linalg.norm(reach))
                is_off = bool(_distances(both, found)[0][row] > limit)
                cost, out = found.cost, row
        if not is_off:
            break
        agree = agree.copy()
        agree[out] = False
    return agree


def _samples(count: int) -> list[tuple[int, ...]]:
    """Rows of markers by which the others are placed; of very many, not all pairs."""
    if count == 1:
        return [(0,)]
    if count <= _ALL_PAIRS:
        return list(combinations(range(count), 2))
    steps = (1, count // 3, count // 2)
    return [(row, (row + step) % count) for step in steps for row in range(count)]


def _distances(both: _Pairs, found: _Solution) -> tuple[Floats, Floats]:
    """(M,) metres and radians between the markers and where the map has them."""
    moved = found.scale * both.world[:, :3, 3] @ found.rotation.T + found.translation
    turned = [
        rotation_angle(found.rotation @ world[:3, :3] @ mapped[:3, :3].T)
        for world, mapped in zip(both.world, both.map, strict=True)
    ]
    return np.linalg.norm(moved - both.map[:, :3, 3], axis=1), np.array(turned)


def _refine(both: _Pairs, scale_sigma: float) -> _Solution:
    """Gauss and Newton around the middle of the markers."""
    corners = [both.corners(row) for row in range(len(both.ids))]
    source, target = (np.concatenate(each) for each in zip(*corners, strict=True))
    rotation = umeyama(source, target, with_scale=False).rotation
    middle = both.world[:, :3, 3].mean(axis=0)
    arms = both.world[:, :3, 3] - middle
    place, log_scale = both.map[:, :3, 3].mean(axis=0), 0.0
    drift = _DRIFT_RATIO * np.linalg.norm(arms, axis=1)
    sigma_m = np.hypot(both.sigma_m, drift)
    normal, squares = np.eye(7), 0.0
    for _ in range(_ROUNDS):
        normal, gradient, squares = np.zeros((7, 7)), np.zeros(7), 0.0
        normal[6, 6] = scale_sigma**-2
        gradient[6] = log_scale * scale_sigma**-2
        for row in range(len(both.ids)):
            turned = np.exp(log_scale) * rotation @ arms[row]
            off = np.zeros(6)
            off[:3] = (turned + place - both.map[row, :3, 3]) / sigma_m[row]
            left = rotation @ both.world[row, :3, :3] @ both.map[row, :3, :3].T
            off[3:] = so3_log(left) / both.sigma_rad[row]
            by = np.zeros((6, 7))
            by[:3, :3], by[:3, 3:6] = -skew(turned) / sigma_m[row], np.eye(3) / sigma_m[row]
            by[:3, 6] = turned / sigma_m[row]
            by[3:, :3] = np.eye(3) / both.sigma_rad[row]
            normal += by.T @ by
            gradient += by.T @ off
            squares += float(off @ off)
        step = np.asarray(-np.linalg.solve(normal, gradient), np.float64)
        rotation = so3_exp(step[:3]) @ rotation
        place, log_scale = place + step[3:6], log_scale + float(step[6])
    scale = float(np.exp(log_scale))
    free = 6 * len(both.ids) - 7
    worse = max(1.0, squares / free) if free > 0 else 1.0
    covariance = worse * np.linalg.inv(normal)
    cost = squares + (log_scale / scale_sigma) ** 2
    shift = place - scale * rotation @ middle
    return _Solution(rotation, shift, scale, np.asarray(covariance), cost)


def _contradiction(both: _Pairs) -> str:
    """The words for the pair of markers whose distances differ most, or for a wrong unit."""
    pairs = list(combinations(range(len(both.ids)), 2))
    seen, given = (
        np.array([np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3]) for i, j in pairs])
        for poses in (both.world, both.map)
    )
    ratios = given / np.maximum(seen, 1e-9)
    middle = float(np.median(ratios))
    spread = float(np.abs(ratios / middle - 1.0).max())
    is_unit = len(pairs) > 1 or not 0.2 < middle < 5.0  # two markers may simply have been moved
    if is_unit and spread < 0.5 * abs(middle - 1.0):
        return (
            f"has distances between markers that are {middle:.3g} times those by the sides of the "
            "markers: a length or the unit of the positions is wrong"
        )
    worst = int(np.argmax(np.abs(given - seen)))
    i, j = pairs[worst]
    if abs(given[worst] - seen[worst]) <= _MAX_ERROR_M + _MAX_ERROR_RATIO * given[worst]:
        return (
            f"has markers {both.ids[i]} and {both.ids[j]} turned to each other in another way than "
            "the images: a quaternion or the order of corners is wrong"
        )
    return (
        f"has markers {both.ids[i]} and {both.ids[j]} {given[worst]:.3g} m from each other, and by "
        f"the images they are {seen[worst]:.3g} m: one of them was moved, or its pose is wrong"
    )
