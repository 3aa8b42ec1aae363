"""Least squares over lenses, the board's poses and where the second camera is.

All views of all cameras are adjusted at once by Levenberg and Marquardt's method. The poses are
eliminated from the normal equations (Schur complement), so that what is solved is as small as the
cameras' unknowns; its inverse gives their standard deviations.

Source: Triggs et al., Bundle Adjustment: A Modern Synthesis, 2000, section 6.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from vo.calibrating.projection import Lens, Seen, see
from vo.types import Floats, Ints

_MAX_ITERATIONS = 100
_CONVERGED = 1e-7
_LOWEST_DAMPING, _HIGHEST_DAMPING = 1e-12, 1e9
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
        sigmas: standard deviations of the cameras, under the errors that the residuals show; the
            poses are left out.
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


class _System(NamedTuple):
    """Normal equations of p unknowns of the cameras and 6 of each of V poses.

    Attributes:
        outer: (p, p) of the cameras alone.
        mixed: (V, p, 6) of cameras and poses.
        inner: (V, 6, 6) of the poses alone.
        outer_gradient: (p,).
        inner_gradient: (V, 6).
        residuals: (N, 2) of each sight.
    """

    outer: Floats
    mixed: Floats
    inner: Floats
    outer_gradient: Floats
    inner_gradient: Floats
    residuals: list[Floats]

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(sum(np.sum(each**2) for each in self.residuals))


def adjust(
    lenses: Sequence[Lens], sights: Sequence[Sight], points: Floats, start: Unknowns
) -> Adjusted:
    """Find the unknowns that explain the sights best.

    Args:
        lenses: of each camera.
        sights: all of them; every view has one at least.
        points: (M, 3) corners on the board, by id.
        start: where to begin.
    """
    unknowns = start
    system = _normal_equations(lenses, sights, points, unknowns)
    cost, damping = system.cost, 1e-3
    for _ in range(_MAX_ITERATIONS):
        trial = unknowns.moved(_step(system, damping))
        moved = _normal_equations(lenses, sights, points, trial)
        if not moved.cost < cost:  # nor where it is NaN
            damping *= 10.0
            if damping > _HIGHEST_DAMPING:
                break
            continue
        has_converged = cost - moved.cost < _CONVERGED * cost
        unknowns, system, cost = trial, moved, moved.cost
        damping = max(damping / 10.0, _LOWEST_DAMPING)
        if has_converged:
            break
    return Adjusted(unknowns, _sigmas(system, unknowns), tuple(system.residuals))


def _look(
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
) -> _System:
    begins = [sum(lens.size for lens in lenses[:camera]) for camera in range(len(lenses) + 1)]
    size = begins[-1] + (0 if unknowns.cam1_from_cam0 is None else 6)
    views = len(unknowns.poses)
    system = _System(
        np.zeros((size, size)),
        np.zeros((views, size, 6)),
        np.zeros((views, 6, 6)),
        np.zeros(size),
        np.zeros((views, 6)),
        [],
    )
    for sight in sights:
        seen, by_rig = _look(lenses, sight, points, unknowns)
        jacobian = np.zeros((2 * len(sight.ids), size))
        begin = begins[sight.camera]
        jacobian[:, begin : begin + lenses[sight.camera].size] = seen.by_lens
        if by_rig is not None:
            jacobian[:, begins[-1] :] = by_rig
        residual = sight.xy - seen.xy
        system.outer[:] += jacobian.T @ jacobian
        system.mixed[sight.view] += jacobian.T @ seen.by_pose
        system.inner[sight.view] += seen.by_pose.T @ seen.by_pose
        system.outer_gradient[:] += jacobian.T @ residual.ravel()
        system.inner_gradient[sight.view] += seen.by_pose.T @ residual.ravel()
        system.residuals.append(residual)
    return system


def _step(system: _System, damping: float) -> Floats:
    """Where to go from here, as long as `Unknowns.vector`; diagonals raised by the damping."""
    inner = system.inner * (1.0 + damping * np.eye(6))
    outer = system.outer * (1.0 + damping * np.eye(len(system.outer)))
    reduced, through = _reduced(outer, system.mixed, inner)
    gradient = system.outer_gradient - np.einsum("vpi,vi->p", through, system.inner_gradient)
    scale = _scale(outer)
    unit = reduced * scale[:, None] * scale
    cameras = scale * np.linalg.lstsq(unit, scale * gradient, rcond=None)[0]
    rest = system.inner_gradient - np.einsum("vpi,p->vi", system.mixed, cameras)
    poses = np.linalg.solve(inner, rest[:, :, None])
    return np.concatenate([cameras, poses.ravel()])


def _reduced(outer: Floats, mixed: Floats, inner: Floats) -> tuple[Floats, Floats]:
    """The Schur complement (p, p), and mixed times inverse inner (V, p, 6)."""
    through = np.linalg.solve(inner, mixed.transpose(0, 2, 1)).transpose(0, 2, 1)
    return np.asarray(outer - np.einsum("vpi,vqi->pq", through, mixed)), np.asarray(through)


def _scale(matrix: Floats) -> Floats:
    """Makes the diagonal 1: pixels, radians and coefficients differ by orders of magnitude."""
    return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-12)))


def _sigmas(system: _System, unknowns: Unknowns) -> Unknowns:
    inner = system.inner * (1.0 + _LOWEST_DAMPING * np.eye(6))
    reduced, _ = _reduced(system.outer, system.mixed, inner)
    scale = _scale(system.outer)
    values, vectors = np.linalg.eigh(reduced * scale[:, None] * scale)
    # What the views do not determine gets a huge deviation instead of none.
    inverse = vectors**2 @ (1.0 / np.maximum(values, _SMALLEST_EIGENVALUE))
    count = 2 * sum(len(each) for each in system.residuals)
    freedom = max(count - len(scale) - unknowns.poses.size, 1)
    deviations = scale * np.sqrt(inverse * system.cost / freedom)
    zero = Unknowns(
        tuple(np.zeros_like(each) for each in unknowns.intrinsics),
        np.zeros((0, 6)),
        None if unknowns.cam1_from_cam0 is None else np.zeros(6),
    )
    return zero.moved(deviations)
