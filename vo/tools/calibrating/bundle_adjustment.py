"""Bundle adjustment of lenses, board poses and the pose of the second camera.

All views of all cameras are adjusted together by the Levenberg-Marquardt method. The board poses
are eliminated from the normal equations by the Schur complement, so that the system to solve has
only the cameras' parameters; its inverse gives their standard deviations.

Source: Triggs et al., Bundle Adjustment: A Modern Synthesis, 2000, section 6.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.types import Floats, Ints
from vo.tools.calibrating.projection import LensModel, Projection, project

_MAX_ITERATIONS = 100
_CONVERGED = 1e-7
_MIN_DAMPING, _MAX_DAMPING = 1e-12, 1e9
_MIN_EIGENVALUE = 1e-16


@dataclass(frozen=True, eq=False)
class Observation:
    """Corners of the board in one image."""

    view: int  # number of the view; both images of a pair have the same
    camera: int  # 0 or 1
    ids: Ints  # (N,) numbers of the corners on the board
    xy: Floats  # (N, 2) pixels


@dataclass(frozen=True, eq=False)
class Parameters:
    """Parameters of the adjustment."""

    intrinsics: tuple[Floats, ...]  # one array per camera, as in `project`
    poses: Floats  # (V, 6) rotation vectors and translations of cam0_from_board
    # (6,) rotation vector and translation; None with one camera
    cam1_from_cam0: Floats | None = None

    def vector(self) -> Floats:
        """All parameters as one vector: intrinsics, cam1_from_cam0, poses."""
        extrinsics = () if self.cam1_from_cam0 is None else (self.cam1_from_cam0,)
        return np.concatenate([*self.intrinsics, *extrinsics, self.poses.ravel()])

    def updated(self, step: Floats) -> Parameters:
        """The parameters plus a step in the order of `vector`."""
        values = self.vector() + step
        intrinsics = []
        for known in self.intrinsics:
            intrinsics.append(values[: len(known)])
            values = values[len(known) :]
        extrinsics = None
        if self.cam1_from_cam0 is not None:
            extrinsics, values = values[:6], values[6:]
        return Parameters(tuple(intrinsics), values.reshape(-1, 6), extrinsics)


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """Result of a bundle adjustment."""

    parameters: Parameters
    # Standard deviations of the cameras' parameters, scaled by the residuals; without those of the
    # poses
    sigmas: Parameters
    # (N, 2) per observation: observed minus projected corners, in pixels
    residuals: tuple[Floats, ...]

    @property
    def rms_px(self) -> float:
        """RMS reprojection error of all corners."""
        return rms(self.residuals)


def rms(residuals: Sequence[Floats]) -> float:
    """RMS length of the rows of several (N, 2) arrays."""
    rows = np.concatenate(residuals)
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


class _NormalEquations(NamedTuple):
    """Normal equations in blocks, for p camera parameters and V poses of 6 parameters."""

    camera_hessian: Floats  # (p, p), cameras
    mixed_hessian: Floats  # (V, p, 6), cameras and poses
    pose_hessian: Floats  # (V, 6, 6), poses
    camera_gradient: Floats  # (p,)
    pose_gradient: Floats  # (V, 6)
    residuals: list[Floats]  # (N, 2) per observation

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(sum(np.sum(each**2) for each in self.residuals))


def bundle_adjust(
    lenses: Sequence[LensModel],
    observations: Sequence[Observation],
    points: Floats,
    start: Parameters,
) -> AdjustmentResult:
    """Minimise the squared reprojection errors of all observations.

    `lenses`: lens model of each camera. `observations`: of all views; every view has at least one.
    `points`: (M, 3) corners on the board, by id.
    """
    parameters = start
    system = _linearise(lenses, observations, points, parameters)
    cost, damping = system.cost, 1e-3
    for _ in range(_MAX_ITERATIONS):
        trial = parameters.updated(_step(system, damping))
        trial_system = _linearise(lenses, observations, points, trial)
        if not trial_system.cost < cost:  # also if it is NaN
            damping *= 10.0
            if damping > _MAX_DAMPING:
                break
            continue
        has_converged = cost - trial_system.cost < _CONVERGED * cost
        parameters, system, cost = trial, trial_system, trial_system.cost
        damping = max(damping / 10.0, _MIN_DAMPING)
        if has_converged:
            break
    return AdjustmentResult(parameters, _sigmas(system, parameters), tuple(system.residuals))


def _project_observation(
    lenses: Sequence[LensModel], observation: Observation, points: Floats, parameters: Parameters
) -> tuple[Projection, Floats | None]:
    """Projection of an observed board; for camera 1 also its Jacobian by cam1_from_cam0."""
    pose = parameters.poses[observation.view]
    lens, intrinsics = lenses[observation.camera], parameters.intrinsics[observation.camera]
    if observation.camera == 0 or parameters.cam1_from_cam0 is None:
        return project(lens, intrinsics, pose, points[observation.ids]), None
    other = parameters.cam1_from_cam0
    turn, shift, *d = cv2.composeRT(pose[:3], pose[3:], other[:3], other[3:])
    composed = np.concatenate([turn, shift]).ravel()
    projection = project(lens, intrinsics, composed, points[observation.ids])
    # Chain rule through cam1_from_board = cam1_from_cam0 @ cam0_from_board.
    by_first = np.block([[d[0], d[1]], [d[4], d[5]]])
    by_second = np.block([[d[2], d[3]], [d[6], d[7]]])
    extrinsics_jacobian = projection.pose_jacobian @ by_second
    return (
        projection._replace(pose_jacobian=projection.pose_jacobian @ by_first),
        extrinsics_jacobian,
    )


def _linearise(
    lenses: Sequence[LensModel],
    observations: Sequence[Observation],
    points: Floats,
    parameters: Parameters,
) -> _NormalEquations:
    begins = [sum(lens.size for lens in lenses[:camera]) for camera in range(len(lenses) + 1)]
    size = begins[-1] + (0 if parameters.cam1_from_cam0 is None else 6)
    views = len(parameters.poses)
    system = _NormalEquations(
        np.zeros((size, size)),
        np.zeros((views, size, 6)),
        np.zeros((views, 6, 6)),
        np.zeros(size),
        np.zeros((views, 6)),
        [],
    )
    for observation in observations:
        projection, extrinsics_jacobian = _project_observation(
            lenses, observation, points, parameters
        )
        jacobian = np.zeros((2 * len(observation.ids), size))
        begin = begins[observation.camera]
        end = begin + lenses[observation.camera].size
        jacobian[:, begin:end] = projection.intrinsics_jacobian
        if extrinsics_jacobian is not None:
            jacobian[:, begins[-1] :] = extrinsics_jacobian
        pose_jacobian, view = projection.pose_jacobian, observation.view
        residual = observation.xy - projection.xy
        system.camera_hessian[:] += jacobian.T @ jacobian
        system.mixed_hessian[view] += jacobian.T @ pose_jacobian
        system.pose_hessian[view] += pose_jacobian.T @ pose_jacobian
        system.camera_gradient[:] += jacobian.T @ residual.ravel()
        system.pose_gradient[view] += pose_jacobian.T @ residual.ravel()
        system.residuals.append(residual)
    return system


def _step(system: _NormalEquations, damping: float) -> Floats:
    """Levenberg-Marquardt step in the order of `Parameters.vector`."""
    poses = system.pose_hessian * (1.0 + damping * np.eye(6))
    cameras = system.camera_hessian * (1.0 + damping * np.eye(len(system.camera_hessian)))
    reduced, elimination = _schur_complement(cameras, system.mixed_hessian, poses)
    gradient = system.camera_gradient - np.einsum("vpi,vi->p", elimination, system.pose_gradient)
    scale = _unit_diagonal_scale(cameras)
    unit = reduced * scale[:, None] * scale
    camera_step = scale * np.linalg.lstsq(unit, scale * gradient, rcond=None)[0]
    rest = system.pose_gradient - np.einsum("vpi,p->vi", system.mixed_hessian, camera_step)
    pose_steps = np.linalg.solve(poses, rest[:, :, None])
    return np.concatenate([camera_step, pose_steps.ravel()])


def _schur_complement(cameras: Floats, mixed: Floats, poses: Floats) -> tuple[Floats, Floats]:
    """The Schur complement (p, p), and mixed @ inverse(poses) (V, p, 6)."""
    elimination = np.linalg.solve(poses, mixed.transpose(0, 2, 1)).transpose(0, 2, 1)
    reduced = cameras - np.einsum("vpi,vqi->pq", elimination, mixed)
    return np.asarray(reduced), np.asarray(elimination)


def _unit_diagonal_scale(matrix: Floats) -> Floats:
    """Scale for a unit diagonal, as pixels, radians and coefficients differ by magnitudes."""
    return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-12)))


def _sigmas(system: _NormalEquations, parameters: Parameters) -> Parameters:
    poses = system.pose_hessian * (1.0 + _MIN_DAMPING * np.eye(6))
    reduced, _ = _schur_complement(system.camera_hessian, system.mixed_hessian, poses)
    scale = _unit_diagonal_scale(system.camera_hessian)
    values, vectors = np.linalg.eigh(reduced * scale[:, None] * scale)
    # Parameters that the views do not determine get a huge deviation instead of none.
    inverse = vectors**2 @ (1.0 / np.maximum(values, _MIN_EIGENVALUE))
    count = 2 * sum(len(each) for each in system.residuals)
    freedom = max(count - len(scale) - parameters.poses.size, 1)
    deviations = scale * np.sqrt(inverse * system.cost / freedom)
    zero = Parameters(
        tuple(np.zeros_like(each) for each in parameters.intrinsics),
        np.zeros((0, 6)),
        None if parameters.cam1_from_cam0 is None else np.zeros(6),
    )
    return zero.updated(deviations)
