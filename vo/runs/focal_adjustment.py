"""Bundle adjustment of keyframes whose focal length changes from one to the next.

The states are poses, landmarks, and the logarithm of each keyframe's focal length, which takes a
random walk; the rest of the lens is as calibrated. Landmarks are eliminated (Triggs et al.,
"Bundle Adjustment: A Modern Synthesis", 2000, sec. 6.1). A longer focal length enlarges near and
far things alike, and a motion forward near ones more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from vo.base.geometry.cameras import distort
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats
from vo.engine.backend.lens_adjustment import KeyframeViews
from vo.engine.geometry import so3
from vo.engine.geometry.levenberg_marquardt import Law, minimise

_ROUNDS = 3  # from the second on, residuals give weights
_LAW = Law(20, 1e-4, damping=1e-3, most=1e6, tries=20, factor=8.0)
# Patches of a landmark err alike from one keyframe to the next, so that residuals are smaller.
_SIGMA_PX, _MIN_SIGMA_PX, _CORRELATION, _HUBER = 0.5, 0.1, 4.0, 0.5
# A focal length rests or changes much: steps have Student's rather than a normal distribution.
_RESTING = 0.0005
_STEP = 1e-4  # of numerical derivatives
_NOWHERE = 1e4  # pixels
_SIZE = 7  # of a keyframe: rotation, position, logarithm of the focal length


class FocalPrior(NamedTuple):
    """What is known beforehand: (K,) logarithms with standard deviations, and (K - 1,) of steps."""

    log_focal: Floats
    sigma: Floats  # infinite where nothing is known
    step_sigma: Floats


class AdjustedFocal(NamedTuple):
    """Logarithms of the focal length relative to the camera's (K,), and standard deviations."""

    log_focal: Floats
    sigma: Floats
    residual_px: float


@dataclass(frozen=True, eq=False)
class _State:
    cam_from_world: Floats
    points: Floats
    log_focal: Floats


def adjust_focal_lengths(views: KeyframeViews, camera: Camera, prior: FocalPrior) -> AdjustedFocal:
    """The most probable focal lengths of keyframes.

    Raises:
        numpy.linalg.LinAlgError: the observations do not determine them.
    """
    poses = inverse(views.world_from_cam)
    unit = float(np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1).max())
    if not unit > 0.0:
        raise np.linalg.LinAlgError("the camera did not move")
    poses[:, :3, 3] /= unit
    problem = _Problem(views, camera, prior)
    state = _State(poses, views.points / unit, prior.log_focal.copy())
    for number in range(_ROUNDS):
        if number > 0:
            problem.weigh(state)
        state = minimise(problem, state, _LAW)
    variance = np.diag(np.linalg.inv(problem.reduced(state)))[_SIZE - 6 - 1 :: _SIZE]
    return AdjustedFocal(
        state.log_focal, np.sqrt(np.maximum(variance, 0.0)), problem.median_residual(state)
    )


class _Problem:
    def __init__(self, views: KeyframeViews, camera: Camera, prior: FocalPrior) -> None:
        self._views, self._camera, self._prior = views, camera, prior
        self._sigma, self._most = _SIGMA_PX, prior.step_sigma
        order = np.lexsort((views.keyframe, views.point))
        self._keyframe, self._point = views.keyframe[order], views.point[order]
        self._off = views.xy[order] - (camera.cx, camera.cy)
        self._starts = np.searchsorted(self._point, np.arange(len(views.points)))
        self._rows = [np.flatnonzero(self._keyframe == k) for k in range(len(prior.log_focal))]

    def weigh(self, state: _State) -> None:
        """Take the noise of pixels from the residuals, and that of the walk from its steps."""
        self._sigma = max(_CORRELATION * self.median_residual(state) / 1.18, _MIN_SIGMA_PX)
        steps = np.hypot(np.diff(state.log_focal), _RESTING)
        self._prior = self._prior._replace(step_sigma=np.minimum(steps, self._most))

    def median_residual(self, state: _State) -> float:
        """In pixels."""
        return float(np.median(np.linalg.norm(self._errors(state)[0], axis=1)))

    def steps(self, state: _State) -> Callable[[float], tuple[Floats, Floats]]:
        """Steps of keyframes and landmarks."""
        return partial(_solved, *self._linearised(state))

    def reduced(self, state: _State) -> Floats:
        """Information of all but the first pose, with the landmarks eliminated."""
        hessian, _, coupling, normal, _ = self._linearised(state)
        lifted = coupling @ np.linalg.inv(_raised(normal, 1e-9))
        size = len(hessian)
        found = hessian - _flat(lifted, size) @ _flat(coupling, size).T
        # The extent of the map is not observed.
        return np.asarray(found + 1e-9 * np.trace(found) / size * np.eye(size))[6:, 6:]

    def _errors(self, state: _State) -> tuple[Floats, Floats, Floats]:
        """Residuals (N, 2) in recorded pixels, points in cameras (N, 3), and factors (N, 1).

        Residuals are not those of pixels at one focal length, which a longer one makes smaller.
        """
        pose = state.cam_from_world[self._keyframe]
        xyz = np.einsum("nij,nj->ni", pose[:, :3, :3], state.points[self._point]) + pose[:, :3, 3]
        factor = np.exp(state.log_focal[self._keyframe])[:, None]
        return factor * self._seen(xyz) - self._off, xyz, factor

    def _seen(self, xyz: Floats) -> Floats:
        """Pixels (N, 2) off the principal point as calibrated; far away where there is none."""
        rays = xyz[:, :2] / np.maximum(xyz[:, 2:], 1e-6)
        camera = self._camera
        return np.nan_to_num(distort(camera, rays) - (camera.cx, camera.cy), nan=_NOWHERE)

    def _weights(self, errors: Floats) -> tuple[Floats, Floats]:
        """Huber's weights (N,), and costs."""
        length = np.linalg.norm(errors, axis=1) / self._sigma
        large = length > _HUBER
        cost = np.where(large, _HUBER * (length - 0.5 * _HUBER), 0.5 * length * length)
        return np.where(large, _HUBER / np.maximum(length, _HUBER), 1.0), cost

    def cost(self, state: _State) -> float:
        """Half the squared errors, robust."""
        prior, log_focal = self._prior, state.log_focal
        steps = np.diff(log_focal) / prior.step_sigma
        known = (log_focal - prior.log_focal) / prior.sigma
        pixels = self._weights(self._errors(state)[0])[1].sum()
        return float(pixels + 0.5 * steps @ steps + 0.5 * known @ known)

    def _linearised(self, state: _State) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Normal matrix and gradient of keyframes, coupling, and both of the points.

        (7 K, 7 K), (7 K,), (M, 7 K, 3), (M, 3, 3) and (M, 3).
        """
        errors, xyz, factor = self._errors(state)
        weight = np.sqrt(self._weights(errors)[0]) / self._sigma
        by_cam = self._by_camera(xyz) * (factor * weight[:, None])[:, :, None]
        by_point = by_cam @ state.cam_from_world[self._keyframe][:, :3, :3]
        by_focal = (errors + self._off) * weight[:, None]
        errors = errors * weight[:, None]
        by_turn = np.cross(xyz[:, None], by_cam)
        by_pose = np.concatenate([by_turn, by_cam, by_focal[:, :, None]], axis=2)
        count, points = len(self._rows), len(state.points)
        hessian, gradient = np.zeros((count, _SIZE, count, _SIZE)), np.zeros((count, _SIZE))
        for k, rows in enumerate(self._rows):
            part = by_pose[rows].reshape(-1, _SIZE)
            hessian[k, :, k] = part.T @ part
            gradient[k] = part.T @ errors[rows].reshape(-1)
        coupling = np.zeros((points, count, _SIZE, 3))
        coupling[self._point, self._keyframe] = by_pose.transpose(0, 2, 1) @ by_point
        normal = np.add.reduceat(by_point.transpose(0, 2, 1) @ by_point, self._starts)
        right = np.add.reduceat(np.einsum("nri,nr->ni", by_point, errors), self._starts)
        self._add_prior(hessian, gradient, state.log_focal)
        size = count * _SIZE
        return (
            hessian.reshape(size, size),
            gradient.reshape(size),
            coupling.reshape(points, size, 3),
            normal,
            right,
        )

    def _by_camera(self, xyz: Floats) -> Floats:
        """Derivatives (N, 2, 3) of pixels as calibrated by points in the camera."""
        step = _STEP * np.maximum(xyz[:, 2:], 1e-6)
        seen = self._seen(xyz)
        columns = [(self._seen(xyz + step * axis) - seen) / step for axis in np.eye(3)]
        found = np.stack(columns, axis=2)
        return np.where(np.abs(seen[:, :, None]) < _NOWHERE, found, 0.0)

    def _add_prior(self, hessian: Floats, gradient: Floats, log_focal: Floats) -> None:
        prior, last = self._prior, np.arange(len(log_focal))
        hessian[last, -1, last, -1] += prior.sigma**-2
        gradient[:, -1] += (log_focal - prior.log_focal) * prior.sigma**-2
        weight = prior.step_sigma**-2
        a, b = last[:-1], last[1:]
        hessian[a, -1, a, -1] += weight
        hessian[b, -1, b, -1] += weight
        hessian[a, -1, b, -1] -= weight
        hessian[b, -1, a, -1] -= weight
        gradient[a, -1] -= weight * np.diff(log_focal)
        gradient[b, -1] += weight * np.diff(log_focal)

    def moved(self, state: _State, step: tuple[Floats, Floats]) -> _State:
        """The state after a step."""
        each, points = step[0].reshape(-1, _SIZE), step[1]
        turned = [make_transform(so3.exp(s[None, :3])[0], s[3:6]) for s in each]
        return _State(
            np.stack(turned) @ state.cam_from_world,
            state.points + points,
            state.log_focal + each[:, -1],
        )


def _solved(
    hessian: Floats,
    gradient: Floats,
    coupling: Floats,
    normal: Floats,
    right: Floats,
    damping: float,
) -> tuple[Floats, Floats]:
    """Steps of keyframes (7 K,), the first pose fixed, and of points (M, 3)."""
    size = len(gradient)
    undone = np.linalg.inv(_raised(normal, damping))
    lifted = _flat(coupling @ undone, size)
    matrix = hessian + damping * np.diag(np.diag(hessian)) - lifted @ _flat(coupling, size).T
    step = np.zeros(size)
    step[6:] = -np.linalg.solve(matrix[6:, 6:], (gradient - lifted @ right.reshape(-1))[6:])
    points = np.einsum("mij,mj->mi", undone, right + np.einsum("mki,k->mi", coupling, step))
    return step, -points


def _raised(normal: Floats, damping: float) -> Floats:
    diagonal = damping * np.einsum("mii->mi", normal) + 1e-9
    return np.asarray(normal + diagonal[:, :, None] * np.eye(3))


def _flat(coupling: Floats, size: int) -> Floats:
    return np.asarray(coupling.transpose(1, 0, 2).reshape(size, -1))
