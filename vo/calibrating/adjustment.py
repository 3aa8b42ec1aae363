"""Least squares over lenses, the board's poses and where the second camera is.

All views of all cameras are adjusted at once by Levenberg and Marquardt's method; the inverse of
the normal equations gives the standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vo.calibrating.projection import Lens, Seen, see
from vo.types import Floats, Ints

_MAX_ITERATIONS = 100
_CONVERGED = 1e-7
_SMALLEST_EIGENVALUE = 1e-16


@dataclass(frozen=True, eq=False)
class Sight:
    """The corners of the board in one image.

    Attributes:
        view: number of the view; the images of a pair have the same.
        camera: 0 or 1.
        ids: (N,) of the corners.
        xy: (N, 2) pixels.
    """

    view: int
    camera: int
    ids: Ints
    xy: Floats


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is adjusted.

    Attributes:
        intrinsics: of each camera, as `see` takes them.
        poses: (V, 6) rotation vectors and translations of cam0_from_board.
        cam1_from_cam0: (6,) rotation vector and translation; None with one camera.
    """

    intrinsics: tuple[Floats, ...]
    poses: Floats
    cam1_from_cam0: Floats | None = None

    def vector(self) -> Floats:
        """All in one row: intrinsics, cam1_from_cam0, poses."""
        extrinsics = () if self.cam1_from_cam0 is None else (self.cam1_from_cam0,)
        return np.concatenate([*self.intrinsics, *extrinsics, self.poses.ravel()])

    def moved(self, step: Floats) -> Unknowns:
        """With a step as long as `vector` added."""
        values = self.vector() + step
        intrinsics = []
        for known in self.intrinsics:
            intrinsics.append(values[: len(known)])
            values = values[len(known) :]
        extrinsics = None
        if self.cam1_from_cam0 is not None:
            extrinsics, values = values[:6], values[6:]
        return Unknowns(tuple(intrinsics), values.reshape(-1, 6), extrinsics)


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What came out.

    Attributes:
        unknowns: the best values.
        sigmas: their standard deviations, under the errors that the residuals show.
        residuals: (N, 2) of each sight: where the corner is minus where it should be, in pixels.
    """

    unknowns: Unknowns
    sigmas: Unknowns
    residuals: tuple[Floats, ...]

    @property
    def rms_px(self) -> float:
        """Root of the mean squared distance of a corner from where it should be."""
        return rms(self.residuals)


def rms(residuals: Sequence[Floats]) -> float:
    """Root of the mean squared length of rows of (N, 2)."""
    every = np.concatenate(residuals)
    return float(np.sqrt(np.mean(np.sum(every**2, axis=1))))


def adjust(
    lenses: Sequence[Lens], sights: Sequence[Sight], points: Floats, start: Unknowns
) -> Adjusted:
    """Find the unknowns that explain the sights best.

    Args:
        lenses: of each camera.
        sights: all of them.
        points: (M, 3) corners on the board, by id.
        start: where to begin.
    """
    unknowns = start
    matrix, gradient, residuals = _normal_equations(lenses, sights, points, unknowns)
    cost, damping = _cost(residuals), 1e-3
    for _ in range(_MAX_ITERATIONS):
        step = _solved(matrix, gradient, damping)
        trial = unknowns.moved(step)
        system = _normal_equations(lenses, sights, points, trial)
        trial_cost = _cost(system[2])
        if not trial_cost < cost:
            damping *= 10.0
            if damping > 1e9:
                break
            continue
        has_converged = cost - trial_cost < _CONVERGED * cost
        unknowns, cost, damping = trial, trial_cost, max(damping / 10.0, 1e-12)
        matrix, gradient, residuals = system
        if has_converged:
            break
    return Adjusted(unknowns, _sigmas(matrix, cost, residuals, unknowns), tuple(residuals))


def look(
    lenses: Sequence[Lens], sight: Sight, points: Floats, unknowns: Unknowns
) -> tuple[Seen, Floats | None]:
    """A sight as it should be, and for the second camera its derivative by cam1_from_cam0."""
    pose = unknowns.poses[sight.view]
    lens, intrinsics = lenses[sight.camera], unknowns.intrinsics[sight.camera]
    if sight.camera == 0 or unknowns.cam1_from_cam0 is None:
        return see(lens, intrinsics, pose, points[sight.ids]), None
    other = unknowns.cam1_from_cam0
    turn, shift, *d = cv2.composeRT(pose[:3], pose[3:], other[:3], other[3:])
    seen = see(lens, intrinsics, np.concatenate([turn, shift]).ravel(), points[sight.ids])
    by_first = np.block([[d[0], d[1]], [d[4], d[5]]])
    by_second = np.block([[d[2], d[3]], [d[6], d[7]]])
    by_other = seen.by_pose @ by_second
    return seen._replace(by_pose=seen.by_pose @ by_first), by_other


def _normal_equations(
    lenses: Sequence[Lens], sights: Sequence[Sight], points: Floats, unknowns: Unknowns
) -> tuple[Floats, Floats, list[Floats]]:
    size = len(unknowns.vector())
    matrix, gradient, residuals = np.zeros((size, size)), np.zeros(size), []
    after_lenses = sum(lens.size for lens in lenses)
    after_rig = after_lenses + (0 if unknowns.cam1_from_cam0 is None else 6)
    for sight in sights:
        seen, by_other = look(lenses, sight, points, unknowns)
        begin = sum(lens.size for lens in lenses[: sight.camera])
        blocks = [
            (begin, seen.by_lens),
            *([] if by_other is None else [(after_lenses, by_other)]),
            (after_rig + 6 * sight.view, seen.by_pose),
        ]
        where = np.concatenate([np.arange(at, at + block.shape[1]) for at, block in blocks])
        jacobian = np.concatenate([block for _, block in blocks], axis=1)
        residual = sight.xy - seen.xy
        matrix[np.ix_(where, where)] += jacobian.T @ jacobian
        gradient[where] += jacobian.T @ residual.ravel()
        residuals.append(residual)
    return matrix, gradient, residuals


def _cost(residuals: Sequence[Floats]) -> float:
    return float(sum(np.sum(each**2) for each in residuals))


def _solved(matrix: Floats, gradient: Floats, damping: float) -> Floats:
    diagonal = np.maximum(np.diag(matrix), 1e-12)
    scale = 1.0 / np.sqrt(diagonal)
    # Unit diagonal: pixels, radians and coefficients differ by many orders of magnitude.
    scaled = matrix * scale[:, None] * scale + damping * np.eye(len(scale))
    return np.asarray(scale * np.linalg.solve(scaled, scale * gradient))


def _sigmas(
    matrix: Floats, cost: float, residuals: Sequence[Floats], unknowns: Unknowns
) -> Unknowns:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-12))
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    # What the views do not determine gets a huge deviation instead of none.
    inverse = vectors**2 @ (1.0 / np.maximum(values, _SMALLEST_EIGENVALUE))
    freedom = max(2 * sum(len(each) for each in residuals) - len(scale), 1)
    deviations = scale * np.sqrt(inverse * cost / freedom)
    zero = replace(
        unknowns,
        intrinsics=tuple(np.zeros_like(each) for each in unknowns.intrinsics),
        poses=np.zeros_like(unknowns.poses),
        cam1_from_cam0=None if unknowns.cam1_from_cam0 is None else np.zeros(6),
    )
    return zero.moved(deviations)
