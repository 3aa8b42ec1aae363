"""What a window says of how the cameras of a rig are fixed to its body.

Camera 0 is the body; the others have six unknowns each, in the tangent (rx ry rz tx ty tz) of
their own frames, that of its first view.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.residuals import with_measured_noise
from vo.engine.backend.rig_adjustment import AdjustedRig, reduced_to_bodies
from vo.engine.backend.window_problem import Ties, WindowProblem


class ExtrinsicEvidence(NamedTuple):
    """information (6 C, 6 C) @ step = -gradient (6 C,), C cameras but the first.

    The poses of all bodies but the first are unknown, and so is the scale.
    """

    information: Floats
    gradient: Floats


def extrinsic_evidence(
    problem: WindowProblem, ties: Ties, adjusted: AdjustedRig, config: SmoothingConfig
) -> ExtrinsicEvidence:
    """Linearise an optimised window at the extrinsics that it has."""
    poses = adjusted.world_from_cam
    free = replace(
        with_measured_noise(replace(problem, world_from_cam=poses, points=adjusted.points)),
        fixed=np.zeros(len(poses), bool),
    )
    normal = Bundle(free, adjusted.point_ok, config).normal_equations(poses)
    by_camera = _by_camera(ties)
    on_bodies, gradient, coupled = reduced_to_bodies(normal, ties, normal.hessian @ by_camera)
    solved = np.linalg.pinv(on_bodies[6:, 6:], hermitian=True) @ coupled[6:]
    own = by_camera.T @ normal.hessian @ by_camera
    return ExtrinsicEvidence(
        np.asarray(own - coupled[6:].T @ solved),
        np.asarray(by_camera.T @ normal.gradient - solved.T @ gradient[6:]),
    )


def _by_camera(ties: Ties) -> Floats:
    """(6 K, 6 C) how the tangents of the views change with those of their cameras."""
    assert ties.cameras is not None
    cameras, tied = ties.cameras, ties.body_from_view
    count = len(tied) // len(cameras)
    first = np.searchsorted(cameras, cameras)  # view of each camera
    of_first = np.arange(count)[:, None] * len(cameras) + first
    change = adjoint(inverse(tied) @ tied[of_first.ravel()])
    columns = np.zeros((len(tied), 6, cameras[-1] + 1, 6))
    columns[np.arange(len(tied)), :, np.tile(cameras, count)] = change
    return columns[:, :, 1:].reshape(6 * len(tied), -1)
