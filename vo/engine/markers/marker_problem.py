"""Poses of markers and the unit of a path, from all views of the markers.

The poses of the camera are those of the path, in units of its map. Of marker m with corners c (in
metres), rotation R and position t in the map, and of the number k of map units in a metre, a view
with cam_from_world (R_c, t_c) sees the corner

    q = R_c (k R c + t) + t_c,

whose projection is compared with the measured one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, rotation_angle, so3_exp
from vo.base.types import Floats, Ints

_HUBER = 3.0  # standard deviations of a corner's distance
_MAX_ITERATIONS = 30
_CONVERGED = 1e-6  # length of a step
# Drift of the path between two frames: of its length, of the distance of the marker, and radians;
# the residuals show how many times as large it is.
_DRIFT_RATIO, _DRIFT_OF_DEPTH, _DRIFT_RAD = 0.01, 1e-4, 1e-4
_MIN_DRIFT, _MAX_DRIFT = 0.5, 30.0
_UNSEEN_DRIFT = 1.4  # residuals show less of it than there is: simulated paths
_MAX_DRIFT_FRAMES = 120  # for which it is estimated; others are left out
_MAX_ANGLE = np.deg2rad(25.0)  # of a view's marker from the others, to be used at the start


def square_points(length_m: float) -> Floats:
    """(4, 3) corners of a marker in its frame, in the order of `DetectedMarker.corners`."""
    signs = np.array([(-1, 1, 0), (1, 1, 0), (1, -1, 0), (-1, -1, 0)], dtype=np.float64)
    return np.asarray(0.5 * length_m * signs)


class MarkerView(NamedTuple):
    """A marker in one frame.

    Attributes:
        rays: (4, 2) normalised image points of its corners.
        sigma: (2,) standard deviations of them.
        solutions: one or two poses (4, 4), cam_from_marker in metres.
        camera_from_cam0: (4, 4) rotation from the recorded camera to that of the rays.
        is_ambiguous: whether the corners hardly tell which of two solutions is the right one.
    """

    frame_index: int
    stamp_ns: int
    id: int
    rays: Floats
    sigma: Floats
    solutions: tuple[Floats, ...]
    camera_from_cam0: Floats
    length_m: float
    is_ambiguous: bool = False
    dictionary: str = ""


class MarkerState(NamedTuple):
    """Units of the map in a metre, rotations (M, 3, 3) and positions (M, 3) of markers."""

    units: float
    rotations: Floats
    positions: Floats


class LinearProblem(NamedTuple):
    """A problem around a state.

    Attributes:
        cost: Huber's, in standard deviations squared.
        jacobian: (8 N, 6 M + 1), weighted as the residuals are; one more row where units are known.
        residual: (8 N,), or one more.
        by_camera: (N, 8, 6) derivatives by the poses of the cameras.
    """

    cost: float
    jacobian: Floats
    residual: Floats
    distance: Floats
    by_camera: Floats


Solution = tuple[MarkerState, LinearProblem]


class MarkerProblem:
    """Markers and the unit of a path as the unknowns of a least-squares fit.

    Args:
        poses: (N, 4, 4) world_from_cam0 of each, in units of the map.
        unit_sigma: relative standard deviation of the length of a marker in units of the map, which
            are then metres; None where the unit is unknown.
    """

    def __init__(
        self,
        views: Sequence[MarkerView],
        poses: Floats,
        ids: Sequence[int],
        unit_sigma: float | None = None,
    ) -> None:
        self.views = views
        self._unit_sigma = unit_sigma
        self.ids = ids
        self.marker = np.array([ids.index(view.id) for view in views])
        camera = np.stack([view.camera_from_cam0 for view in views])
        self._cam_from_world = camera @ inverse(poses)
        self._rays = np.stack([view.rays for view in views])
        self._sigma = np.stack([view.sigma for view in views])[:, None]
        self._corners = np.stack([square_points(view.length_m) for view in views])

    def first_guess(self, *, fixed_scale: bool) -> MarkerState | None:
        """The scale by linear least squares, with the solution of each view that others confirm."""
        world_from_cam = inverse(self._cam_from_world)
        rotations, chosen = [], np.zeros(len(self.views), dtype=np.int64)
        used = np.zeros(len(self.views), dtype=bool)
        for m in range(len(self.ids)):
            rows = np.flatnonzero(self.marker == m)
            reference = self._reference(rows, world_from_cam)
            rotations.append(reference)
            for row in rows.tolist():
                angles = [
                    rotation_angle((world_from_cam[row] @ s)[:3, :3].T @ reference)
                    for s in self.views[row].solutions
                ]
                chosen[row] = int(np.argmin(angles))
                used[row] = min(angles) < _MAX_ANGLE
        arms = np.stack(
            [
                pose[:3, :3] @ view.solutions[n][:3, 3]
                for pose, view, n in zip(world_from_cam, self.views, chosen.tolist(), strict=True)
            ]
        )
        return self._linear(arms, world_from_cam[:, :3, 3], used, np.array(rotations), fixed_scale)

    def _linear(
        self, arms: Floats, centres: Floats, used: Floats, rotations: Floats, fixed_scale: bool
    ) -> MarkerState | None:
        """position_m - units * arm = centre of the camera, for each view."""
        count = len(self.ids)
        if any(not used[self.marker == m].any() for m in range(count)):
            used = np.ones(len(arms), dtype=bool)
        rows = np.flatnonzero(used)
        matrix = np.zeros((3 * len(rows), 3 * count + 1))
        weight = 1.0 / np.maximum(np.linalg.norm(arms[rows], axis=1), 1e-9)
        for i, row in enumerate(rows.tolist()):
            m = self.marker[row]
            matrix[3 * i : 3 * i + 3, 3 * m : 3 * m + 3] = weight[i] * np.eye(3)
            matrix[3 * i : 3 * i + 3, -1] = -weight[i] * arms[row]
        target = (weight[:, None] * centres[rows]).ravel()
        if fixed_scale:
            solution = np.linalg.lstsq(matrix[:, :-1], target - matrix[:, -1], rcond=None)[0]
            solution = np.append(solution, 1.0)
        else:
            solution = np.linalg.lstsq(matrix, target, rcond=None)[0]
        if not np.isfinite(solution).all() or solution[-1] <= 0.0:
            return None
        return MarkerState(float(solution[-1]), rotations, solution[:-1].reshape(-1, 3))

    def _reference(self, rows: Ints, world_from_cam: Floats) -> Floats:
        """The orientation of a marker in the world that most views agree with."""
        candidates = [
            [(world_from_cam[row] @ each)[:3, :3] for each in self.views[row].solutions]
            for row in rows.tolist()
        ]
        step = max(1, len(candidates) // 20)
        best, lowest = candidates[0][0], np.inf
        for guess in (each for view in candidates[::step] for each in view):
            cost = sum(min(rotation_angle(each.T @ guess) for each in view) for view in candidates)
            if cost < lowest:
                best, lowest = guess, cost
        return np.asarray(best, np.float64)

    def solve(self, state: MarkerState, *, has_drift: bool = True) -> Solution | None:
        """Robust least squares by Levenberg and Marquardt, and a step with the drift of the path.

        The linear problem of the result, and so its covariance, is that before this step.
        """
        found = self._linearise(state)
        damping = 1e-4
        for _ in range(_MAX_ITERATIONS):
            if found is None:
                return None
            cost, jacobian, residual = found[:3]
            normal = jacobian.T @ jacobian
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            step = np.asarray(
                np.linalg.lstsq(damped, -jacobian.T @ residual, rcond=None)[0], np.float64
            )
            moved = _moved(state, step)
            trial = self._linearise(moved)
            if trial is None or trial[0] > cost:
                damping *= 10.0
                if damping > 1e8:
                    break
                continue
            state, found, damping = moved, trial, max(0.1 * damping, 1e-9)
            if np.linalg.norm(step) < _CONVERGED:
                break
        if found is None:
            return None
        return (self._with_drift(state, found) if has_drift else state), found

    def _with_drift(self, state: MarkerState, found: LinearProblem) -> MarkerState:
        """The state by generalised least squares: errors of views that follow a drift are alike.

        The same state with more frames than those for which the drift is estimated.
        """
        jacobian, residual, walk, size = self._walk(state, found)
        if len(residual) < len(found.residual):
            return state
        walk = size * walk
        inner = np.linalg.inv(np.eye(walk.shape[1]) + walk.T @ walk)
        weighted = jacobian - walk @ (inner @ (walk.T @ jacobian))  # by (I + walk walk^T)^-1
        normal = weighted.T @ jacobian
        step = -np.linalg.lstsq(normal, weighted.T @ residual, rcond=None)[0]
        moved = _moved(state, np.asarray(step, np.float64))
        return state if self._linearise(moved) is None else moved

    def _linearise(self, state: MarkerState) -> LinearProblem | None:
        """The problem around a state; None if a marker is behind a camera."""
        rotation = state.rotations[self.marker]
        in_world = state.units * (self._corners @ np.swapaxes(rotation, 1, 2))
        cam_rotation = self._cam_from_world[:, :3, :3]
        placed = in_world + state.positions[self.marker][:, None]
        q = placed @ np.swapaxes(cam_rotation, 1, 2) + self._cam_from_world[:, None, :3, 3]
        if q[..., 2].min() < 1e-6:
            return None
        inverse_z = 1.0 / q[..., 2]
        uv = q[..., :2] * inverse_z[..., None]
        residual = (uv - self._rays) / self._sigma
        distance = np.linalg.norm(residual, axis=2)
        weight = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(distance, 1e-12)))
        cost = np.where(
            distance < _HUBER, 0.5 * distance**2, _HUBER * (distance - 0.5 * _HUBER)
        ).sum()
        by_q = np.zeros((*q.shape[:2], 2, 3))
        by_q[..., 0, 0] = by_q[..., 1, 1] = inverse_z
        by_q[..., 0, 2], by_q[..., 1, 2] = -uv[..., 0] * inverse_z, -uv[..., 1] * inverse_z
        by_q *= (weight[..., None] / self._sigma)[..., None]
        jacobian = self._jacobian(state, by_q, cam_rotation, in_world)
        weighted = (residual * weight[..., None]).ravel()
        if self._unit_sigma is not None:
            error = np.log(state.units) / self._unit_sigma
            row = np.append(np.zeros(jacobian.shape[1] - 1), 1.0 / self._unit_sigma)
            jacobian, weighted = np.vstack([jacobian, row]), np.append(weighted, error)
            cost += 0.5 * error**2
        return LinearProblem(float(cost), jacobian, weighted, distance, _by_camera(by_q, q))

    def _jacobian(
        self, state: MarkerState, by_q: Floats, cam_rotation: Floats, in_world: Floats
    ) -> Floats:
        by_position = by_q @ cam_rotation[:, None]  # (N, 4, 2, 3)
        count = len(self.ids)
        jacobian = np.zeros((*by_q.shape[:3], 6 * count + 1))
        # exp(w) R: a corner moves by w x p; log(units): it moves by p.
        by_rotation = np.cross(in_world[:, :, None], by_position)
        for m in range(count):
            rows = np.flatnonzero(self.marker == m)
            jacobian[rows, :, :, 6 * m : 6 * m + 3] = by_rotation[rows]
            jacobian[rows, :, :, 6 * m + 3 : 6 * m + 6] = by_position[rows]
        jacobian[..., -1] = np.sum(by_position * in_world[:, :, None], axis=3)
        return jacobian.reshape(-1, 6 * count + 1)

    def covariance(self, solution: Solution, max_drift: float = _MAX_DRIFT) -> Floats:
        """(6 M + 1, 6 M + 1) of rotations and positions by marker, and the logarithm of units.

        That of the corners and of the drift of the path since the first view: as large as residuals
        show, up to `max_drift` times 1 % of its length.
        """
        state, found = solution
        normal = found.jacobian.T @ found.jacobian
        inverse_normal = np.asarray(np.linalg.pinv(normal, hermitian=True), np.float64)
        return np.asarray(inverse_normal + self._drift(state, found, max_drift))

    def _drift(self, state: MarkerState, found: LinearProblem, max_drift: float) -> Floats:
        """Covariance of the parameters by a random walk of the poses of the path."""
        jacobian, _, walk, size = self._walk(state, found)
        moved = min(size, max_drift) * (np.linalg.pinv(jacobian) @ walk)
        return np.asarray(moved @ moved.T)

    def _walk(
        self, state: MarkerState, found: LinearProblem
    ) -> tuple[Floats, Floats, Floats, float]:
        """Jacobian and residuals of some views, their derivatives by a random walk, and its size.

        A drift along the path looks like another scale, so that residuals cannot show all of it.
        The sum of their squares shows its size: it exceeds that of the corners alone by as much as
        a random walk of that size leaves, after the parameters have been fitted to it.
        """
        frames = np.array([view.frame_index for view in self.views])
        numbers = np.unique(frames)
        rows = np.flatnonzero(np.isin(frames, numbers[:: -(-len(numbers) // _MAX_DRIFT_FRAMES)]))
        numbers, order = np.unique(frames[rows], return_inverse=True)
        lines = (8 * rows[:, None] + np.arange(8)).ravel()
        steps = self._step_sizes(state, rows, order, len(numbers))
        by_step = np.zeros((len(rows), 8, len(numbers), 6))
        for k in range(1, len(numbers)):
            later = order >= k
            by_step[later, :, k] = found.by_camera[rows[later]] * steps[k]
        walk = by_step.reshape(len(lines), -1)
        known = np.arange(8 * len(frames), len(found.residual))  # the unit, which does not drift
        lines, walk = np.append(lines, known), np.pad(walk, ((0, len(known)), (0, 0)))
        jacobian, residual = found.jacobian[lines], found.residual[lines]
        left = walk - jacobian @ (np.linalg.pinv(jacobian) @ walk)
        excess = float(residual @ residual) - max(len(residual) - jacobian.shape[1], 0)
        size = np.sqrt(max(excess, 0.0) / max(float(np.sum(left**2)), 1e-12))
        size = float(np.clip(_UNSEEN_DRIFT * size, _MIN_DRIFT, _MAX_DRIFT))
        return jacobian, residual, walk, size

    def _step_sizes(self, state: MarkerState, rows: Ints, order: Ints, count: int) -> Floats:
        """(F, 6) standard deviations of the drift from the frame before, rotation first."""
        first = [int(rows[np.flatnonzero(order == n)[0]]) for n in range(count)]
        centres = inverse(self._cam_from_world[first])[:, :3, 3]
        moved = np.linalg.norm(np.diff(centres, axis=0, prepend=centres[:1]), axis=1)
        depth = np.linalg.norm(state.positions[self.marker[first]] - centres, axis=1)
        along = _DRIFT_RATIO * moved + _DRIFT_OF_DEPTH * depth
        return np.column_stack([np.full((count, 3), _DRIFT_RAD), *[along] * 3])


def _by_camera(by_q: Floats, q: Floats) -> Floats:
    """(N, 8, 6) derivatives by the pose of each camera: exp(xi) @ cam_from_world."""
    by_rotation = np.cross(q[:, :, None], by_q)
    return np.concatenate([by_rotation, by_q], axis=3).reshape(len(q), 8, 6)


def _moved(state: MarkerState, step: Floats) -> MarkerState:
    change = step[:-1].reshape(-1, 6)
    rotations = np.stack(
        [so3_exp(w) @ r for w, r in zip(change[:, :3], state.rotations, strict=True)]
    )
    units = state.units * float(np.exp(np.clip(step[-1], -1.0, 1.0)))
    return MarkerState(units, rotations, state.positions + change[:, 3:])
