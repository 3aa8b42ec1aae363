"""Robust similarity from a path to noisy positions of the same times, with its uncertainty.

The positions may have outliers and jumps: after a jump they have another translation. Their errors
may be correlated in time, as those of GPS are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.similarity import umeyama_each
from vo.base.types import Bools, Floats, Ints
from vo.runs.scaling.correlation import correlated_variance

MIN_POSITIONS = 6
_SAMPLES = 120
_REFINED = 4  # best samples that are refined
_SCORED = 400  # positions by which samples are compared
_SCORE_QUANTILE = 0.4  # of squared residuals: a jump may leave less than half on one side
_ROUNDS = 10
_HUBER = 2.8  # in standard deviations: 5 % of normal errors in three dimensions are larger
_REFUSED = 5.0
_MEDIAN_OF_NORM = 1.538  # median length of a standard normal vector in three dimensions
_MIN_PIECE = 5  # positions between two jumps
_JUMP = 6.0  # in standard deviations of the difference of two positions
_JUMP_SIDE = 4  # positions on each side of a jump that are compared
_PARAMETERS = 7
# Errors below these fractions of the extent are no outliers and no jumps, as the path has some too.
_USUAL_ERROR = 0.001
_MIN_JUMP = 0.003
# Standard deviation of a length between two rounded positions, in units of their resolution.
_ROUNDED = 6.0**-0.5
# Relative standard deviation of the size of the path itself, whose slow drift noise may hide.
_PATH_SIGMA = 0.003


class PositionFit(NamedTuple):
    """Similarity from the path to the positions.

    Attributes:
        scale: length in metres of one unit of the path.
        sigma: its standard deviation.
        rotation: (3, 3).
        translation: (3,) of the piece with the most positions.
        used: (N,) positions that are not outliers.
        jumps: number of jumps of the positions.
        noise_m: standard deviation of their errors along one axis.
        residuals: (N, 3) in metres.
        extent_m: diagonal of the box around the path.
        resolution_m: to which positions are rounded.
    """

    scale: float
    sigma: float
    rotation: Floats
    translation: Floats
    used: Bools
    jumps: int
    noise_m: float
    residuals: Floats
    extent_m: float
    resolution_m: float


class _Solution(NamedTuple):
    scale: float
    rotation: Floats
    shifts: Floats  # (P, 3) translation of each piece


def fit_positions(
    times_s: Floats,
    source: Floats,
    target: Floats,
    sigma: Floats | None = None,
    *,
    with_scale: bool = True,
    resolution_m: float = 0.0,
) -> PositionFit | None:
    """Fit a similarity, or a rigid motion.

    Least squares with Huber's weights (IRLS), begun from the best of seeded samples of three
    positions. The standard deviation of the scale allows for errors that are correlated in time.

    Args:
        times_s: (N,) increasing.
        source: (N, 3) positions of the path.
        target: (N, 3) positions in metres.
        sigma: (N,) standard deviations of the positions, or relative ones; None if all are alike.
        with_scale: False for a path in metres.
        resolution_m: to which positions are rounded.

    Returns None for too few positions, or a path that does not move.
    """
    if len(source) < MIN_POSITIONS or not _moves(source):
        return None
    weight = np.ones(len(source)) if sigma is None else (np.median(sigma) / sigma) ** 2
    piece = np.zeros(len(source), np.int64)
    solution = _best_sample(source, target, weight, with_scale=with_scale)
    if solution is None:
        return None
    smallest = max(_MIN_JUMP * solution.scale * _extent(source), 2.0 * resolution_m)
    jumps = _find_jumps(target - _moved(solution, source, piece), smallest)
    piece = np.searchsorted(jumps, np.arange(len(source)), side="right")
    long = np.bincount(piece)[piece] >= min(_MIN_PIECE, len(source))
    if not long.any():
        return None
    solution, used = _refine(solution, source, target, weight * long, piece, with_scale=with_scale)
    if used.sum() < MIN_POSITIONS or solution.scale <= 0.0:
        return None
    residuals = target - _moved(solution, source, piece)
    centred = solution.scale * _centred(source, weight * used, piece) @ solution.rotation.T
    relative_sigma = _scale_sigma(
        times_s[used], centred[used], residuals[used], weight[used], piece[used]
    )
    of_rounding = resolution_m * _ROUNDED / max(_extent(target[used]), 1e-300)
    scale_sigma = solution.scale * float(np.linalg.norm((relative_sigma, of_rounding, _PATH_SIGMA)))
    largest = np.bincount(piece[used]).argmax()
    return PositionFit(
        solution.scale,
        scale_sigma,
        solution.rotation,
        solution.shifts[largest],
        used,
        len(np.unique(piece[used])) - 1,
        float(np.sqrt((residuals[used] ** 2).mean())),
        residuals,
        solution.scale * _extent(source),
        resolution_m,
    )


def _extent(points: Floats) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _moves(source: Floats) -> bool:
    return bool(np.ptp(source, axis=0).max() > 1e-9)


def _best_sample(
    source: Floats, target: Floats, weight: Floats, *, with_scale: bool
) -> _Solution | None:
    """The solution with the smallest residuals, of samples that were refined on one piece."""
    rng = np.random.default_rng(0)
    count = len(source)
    rows = np.unique(np.linspace(0, count - 1, min(_SCORED, count)).astype(np.int64))
    chosen = np.empty((_SAMPLES, 3), np.int64)
    for sample in chosen:
        # Three positions of a part of the path, far apart: with noise, near ones say nothing.
        length = int(rng.integers(max(count // 3, min(MIN_POSITIONS, count)), count + 1))
        first = int(rng.integers(0, count - length + 1))
        third = length // 3
        sample[:] = [first + int(rng.integers(k * third, (k + 1) * third)) for k in range(3)]
    found = _sampled(source[chosen], target[chosen], with_scale=with_scale)
    scores = _scores(found, source[rows], target[rows])
    piece = np.zeros(count, np.int64)
    best: tuple[float, _Solution] | None = None
    for number in np.argsort(scores, kind="stable")[:_REFINED].tolist():
        solution = found[number]
        refined, _ = _refine(solution, source, target, weight, piece, with_scale=with_scale)
        each_score = (*_scores([refined], source[rows], target[rows]), scores[number])
        for score, each in zip(each_score, (refined, solution), strict=True):
            if each.scale > 0.0 and (best is None or score < best[0]):
                best = float(score), each
    return None if best is None else best[1]


def _sampled(source: Floats, target: Floats, *, with_scale: bool) -> list[_Solution]:
    """Solutions of triples of positions (S, 3, 3), without those of triples in one place."""
    scale, rotation, shift, _, is_spread = umeyama_each(source, target, with_scale=with_scale)
    good = np.flatnonzero(is_spread & (scale > 0.0))
    return [_Solution(float(scale[k]), rotation[k], shift[k : k + 1]) for k in good]


def _scores(solutions: list[_Solution], source: Floats, target: Floats) -> Floats:
    """The quantile of squared residuals of each solution of one piece."""
    if not solutions:
        return np.empty(0)
    turns = np.stack([each.scale * each.rotation.T for each in solutions])
    shifts = np.stack([each.shifts for each in solutions])
    squares = ((target - (source @ turns + shifts)) ** 2).sum(axis=2)
    return np.asarray(np.quantile(squares, _SCORE_QUANTILE, axis=1))


def _moved(solution: _Solution, source: Floats, piece: Ints) -> Floats:
    moved = solution.scale * source @ solution.rotation.T
    return np.asarray(moved + solution.shifts[np.minimum(piece, len(solution.shifts) - 1)])


def _find_jumps(residuals: Floats, smallest: float) -> Ints:
    """First positions after jumps: the residuals on both sides of them differ."""
    count = len(residuals)
    if count < 2 * _MIN_PIECE:
        return np.empty(0, np.int64)
    steps = np.linalg.norm(np.diff(residuals, axis=0), axis=1)
    sigma = float(np.median(steps)) / _MEDIAN_OF_NORM
    jumps: list[int] = []
    smallest = max(_JUMP * sigma, smallest)
    for row in np.argsort(-steps, kind="stable").tolist():
        if steps[row] <= smallest:
            break
        before = residuals[max(row + 1 - _JUMP_SIDE, 0) : row + 1]
        after = residuals[row + 1 : row + 1 + _JUMP_SIDE]
        change = np.linalg.norm(np.median(after, axis=0) - np.median(before, axis=0))
        is_near = any(abs(row + 1 - jump) < _MIN_PIECE for jump in jumps)
        if change > 0.7 * steps[row] and not is_near:
            jumps.append(row + 1)
    return np.array(sorted(jumps), np.int64)


def _refine(
    solution: _Solution,
    source: Floats,
    target: Floats,
    weight: Floats,
    piece: Ints,
    *,
    with_scale: bool,
) -> tuple[_Solution, Bools]:
    """Iteratively reweighted least squares; the solution, and the positions that agree with it."""
    is_known = weight > 0.0
    pieces = int(piece.max()) + 1
    shifts = np.stack([_shift(solution, source, target, piece == p) for p in range(pieces)])
    solution = solution._replace(shifts=shifts)
    used, extent = is_known, _extent(source)
    for _ in range(_ROUNDS):
        residuals = np.linalg.norm(target - _moved(solution, source, piece), axis=1)
        relative = residuals * np.sqrt(weight)
        smallest = _USUAL_ERROR * solution.scale * extent
        sigma = max(float(np.median(relative[is_known])) / _MEDIAN_OF_NORM, smallest, 1e-12)
        used = is_known & (relative <= _REFUSED * sigma)
        robust = weight * np.minimum(1.0, _HUBER * sigma / np.maximum(relative, 1e-300)) * used
        solution = _least_squares(source, target, robust, piece, with_scale=with_scale)
    return solution, used


def _shift(solution: _Solution, source: Floats, target: Floats, rows: Bools) -> Floats:
    moved = solution.scale * source[rows] @ solution.rotation.T
    return np.asarray(np.median(target[rows] - moved, axis=0)) if rows.any() else np.zeros(3)


def _least_squares(
    source: Floats, target: Floats, weight: Floats, piece: Ints, *, with_scale: bool
) -> _Solution:
    """Weighted solution with one translation for each piece (Umeyama 1991)."""
    from_mean, to_mean = _means(source, weight, piece), _means(target, weight, piece)
    x, y = source - from_mean[piece], target - to_mean[piece]
    u, d, vt = np.linalg.svd((weight[:, None] * y).T @ x)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u @ np.diag(signs) @ vt
    spread = float((weight * (x**2).sum(axis=1)).sum())
    scale = float(d @ signs) / max(spread, 1e-300) if with_scale else 1.0
    return _Solution(scale, rotation, to_mean - scale * from_mean @ rotation.T)


def _means(points: Floats, weight: Floats, piece: Ints) -> Floats:
    """(P, 3) weighted mean of each piece."""
    total = np.bincount(piece, weight)
    sums = np.column_stack([np.bincount(piece, weight * column) for column in points.T])
    return np.asarray(sums / np.maximum(total, 1e-300)[:, None])


def _centred(points: Floats, weight: Floats, piece: Ints) -> Floats:
    return np.asarray(points - _means(points, weight, piece)[piece])


def _scale_sigma(
    times_s: Floats, centred: Floats, residuals: Floats, weight: Floats, piece: Ints
) -> float:
    """Relative standard deviation of the scale.

    The scale is decoupled from rotation and translation: an error n_i of position i changes it by
    w_i u_i n_i / sum(w_j u_j u_j), where u are the centred positions. Errors may be larger along
    the path than across it.

    Args:
        times_s: (N,) of positions that are used.
        centred: (N, 3) in metres of the positions, relative to the middle of their piece.
        residuals: (N, 3).
        weight: (N,).
        piece: (N,) number of the part between jumps.
    """
    root = np.sqrt(weight)[:, None]
    u, r = centred * root, residuals * root
    information = float((u**2).sum())
    covariance = r.T @ r / len(r)
    mean_variance = float(np.trace(covariance)) / 3.0
    if mean_variance <= 0.0 or information <= 0.0:
        return 0.0
    along = float(np.einsum("ni,ij,nj->", u, covariance, u)) / (mean_variance * information)
    turns = [np.cross(unit, u) for unit in np.eye(3)]
    shifts = [
        root * np.where(piece[:, None] == number, unit, 0.0)
        for number in np.unique(piece)
        for unit in np.eye(3)
    ]
    variance, inflation = correlated_variance(times_s, u / information, [u, *turns, *shifts], r)
    degrees = max(3.0 * max(len(r) / inflation, 3.0) - _PARAMETERS, 1.0)
    student = 1.0 + 1.2 / degrees  # 95 % of Student's distribution, relative to the normal one
    return float(student * np.sqrt(max(along, 1.0) * variance))
