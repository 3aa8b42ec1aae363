"""Pose of a rig from landmarks in several views: the generalised camera.

Source: Pless, "Using many cameras as one", CVPR 2003; the robust weights are those of
`vo.engine.geometry.pnp`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.projection import MIN_DEPTH, Intrinsics
from vo.base.geometry.transforms import inverse, orthonormalised, se3_exp
from vo.base.types import Bools, Floats, Ints
from vo.engine.rig.velocity import VelocityPrior

_HUBER = 2.0  # residual, in standard deviations, from which a match is weighted down
_ITERATIONS, _CONVERGED = 12, 1e-6  # the latter a squared Mahalanobis length


class RigObservations(NamedTuple):
    """N observations of points by views; rows belong together.

    Attributes:
        points: (N, 3) in the world.
        xy: (N, 2) pixels.
        sigma_px: (N,).
        view: (N,) row of the view.
    """

    points: Floats
    xy: Floats
    sigma_px: Floats
    view: Ints


class RigTies(NamedTuple):
    """How views are fixed to the body, which moves while they take their images.

    Attributes:
        body_from_views: (V, 4, 4).
        delay_s: (V,) time of each view after that of the body's pose.
        twist: (6,) velocity of the body, in its own frame, per second.
        prior: on it; None where the body rests.
    """

    body_from_views: Floats
    delay_s: Floats
    twist: Floats
    prior: VelocityPrior | None = None

    @property
    def at_their_times(self) -> Floats:
        """(V, 4, 4) body_from_view of the body at its own time, and the views at theirs."""
        if not self.delay_s.any():
            return self.body_from_views
        moved = np.stack([se3_exp(delay * self.twist) for delay in self.delay_s.tolist()])
        return np.asarray(moved @ self.body_from_views)


class RigFit(NamedTuple):
    """body_from_world (4, 4), which observations (N,) agree with it, and the ties."""

    body_from_world: Floats
    inlier: Bools
    ties: RigTies


def fit_rig(
    body_from_world: Floats,
    observed: RigObservations,
    ties: RigTies,
    intrinsics: Intrinsics,
    gate: float,
) -> RigFit:
    """Minimise Huber-weighted reprojection errors over the pose of the body.

    Where the ties have a prior on its velocity, over that too. First with
    all observations, then, after convergence or half of the iterations, without outliers: those
    with residuals above `gate` standard deviations.
    """
    moves = ties.prior is not None
    focal, centre = np.array(intrinsics[:2]), np.array(intrinsics[2:])
    limit, pose = np.inf, body_from_world
    for step in range(_ITERATIONS + 1):
        if step == 0 or moves:
            tied = inverse(ties.at_their_times)[observed.view]
            rotation, shift = tied[:, :3, :3], tied[:, :3, 3]
        in_body = observed.points @ pose[:3, :3].T + pose[:3, 3]
        p = np.einsum("nij,nj->ni", rotation, in_body) + shift
        z = np.where(p[:, 2] > MIN_DEPTH, p[:, 2], np.nan)
        error = (p[:, :2] / z[:, None] * focal + centre - observed.xy) / observed.sigma_px[:, None]
        residual = np.nan_to_num(np.hypot(error[:, 0], error[:, 1]), nan=np.inf)
        if step == _ITERATIONS:
            break
        weight = np.sqrt(_HUBER / np.maximum(residual, _HUBER))
        weight[~((residual < limit) & np.isfinite(residual))] = 0.0
        jacobian = _derivatives(p, z, in_body, rotation, weight / observed.sigma_px, focal)
        if moves:  # a body that moves on takes the views with it
            late = -ties.delay_s[observed.view]
            jacobian = np.concatenate([jacobian, late[:, None, None] * jacobian], axis=2)
        jacobian = jacobian.reshape(-1, jacobian.shape[2])
        weighted = (weight[:, None] * np.nan_to_num(error)).ravel()
        normal = jacobian.T @ jacobian
        normal[np.diag_indices_from(normal)] += 1e-9 + 1e-9 * np.diag(normal)
        gradient = jacobian.T @ weighted
        if ties.prior is not None:
            ties.prior.add_to(normal, gradient, inverse(pose), ties.twist)
        try:
            change = -np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:
            break
        is_settled = float(change @ normal @ change) < _CONVERGED
        if is_settled and limit == gate:
            break
        if is_settled or step == _ITERATIONS // 2:
            limit = gate
        pose = np.asarray(se3_exp(np.asarray(change[:6])) @ pose)
        if moves:
            ties = ties._replace(twist=ties.twist + change[6:])
    return RigFit(orthonormalised(pose), residual < gate, ties)


def _derivatives(
    p: Floats, z: Floats, in_body: Floats, rotation: Floats, weight: Floats, focal: Floats
) -> Floats:
    """(N, 2, 6) of weighted pixels of points (N, 3) in views that are turned by (N, 3, 3).

    A step of the body moves its points by r x p + t; what is behind a view has NaN as z.
    """
    scaled = (weight / np.nan_to_num(z, nan=1.0))[:, None] * focal
    ratio = np.nan_to_num(p[:, :2] / z[:, None])
    by_point = scaled[:, :, None] * (rotation[:, :2] - ratio[:, :, None] * rotation[:, 2:])
    return np.concatenate([np.cross(in_body[:, None], by_point), by_point], axis=2)
