"""Maximum-a-posteriori states at keyframes, by Gauss-Newton on the chain of their measurements.

Source: Campos, Montiel and Tardós, "Inertial-only optimization for visual-inertial
initialization", 2020; here the visual motions have their covariance instead of being exact, and the
scale may drift from keyframe to keyframe.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.geometry import so3
from vo.engine.inertial.chain_solver import ChainSolution, Equations, empty_equations, solve_chain
from vo.engine.inertial.factor_kernels import add_changes, add_factors
from vo.engine.inertial.factors import Linearised, as_arrays, inertial_residuals, visual_residuals
from vo.engine.inertial.scale_drift import without_scale
from vo.engine.inertial.states import (
    ACCEL_BIAS,
    GYRO_BIAS,
    LOG_SCALE,
    POSITION,
    ROTATION,
    VELOCITY,
    WIDTH,
    MapErrors,
    States,
    Steps,
)

# Standard deviations before anything is known.
_GYRO_BIAS_RAD_S, _ACCEL_BIAS_M_S2 = 0.1, 0.3
_VELOCITY_M_S, _LOG_SCALE = 100.0, 10.0
_FIXED_M, _FIXED_RAD = 1e-5, 1e-5
_FIXED_LOG_SCALE = 1e-5
# Errors of one camera's steps beside the windows' covariances: in radians, and values of
# `MapErrors` among which the evidence decides, in this order.
_STEP_RAD = 5e-5
_MAP_ERRORS = {
    "ratio": (0.0005, 0.001, 0.002, 0.004, 0.008),
    "drift": (0.0003, 0.0006, 0.0012, 0.0024),
}
QUICK_RAD_S = 1.75  # a single camera that turns faster sees landmarks too shortly for a scale
_TURN_LOG_SCALE = 0.007  # from one keyframe to the next in such a turn
_METRIC_STEP_RATIO, _METRIC_STEP_RAD = 0.0003, 3e-5
# Parts of the variances of metric motions among which the evidence decides: errors over many
# keyframes and over one have these on average (docs/experiments/covariances.md).
PARTS = (0.5, 0.25)
_DOUBT = 2.0  # evidence less than the largest that a value is not refuted by
HUBER = 3.0  # normalised residual from which a visual motion counts less
_MAX_ITERATIONS = 12
_CONVERGED = 0.01  # largest step, in standard deviations
_MAX_TURN_RAD = 0.5  # in one iteration
_MIN_WALK = 1e-6  # rad/s and m/s², standard deviation of a bias's step


class Prior(NamedTuple):
    """Quadratic cost of the first state, by what was measured before it."""

    at: States  # the state (1) that it is about
    information: Floats  # (WIDTH, WIDTH)
    gradient: Floats  # (WIDTH,) at that state


class KnownBiases(NamedTuple):
    """Biases of a sensor at some time, by what was measured before."""

    stamp_ns: int  # the time
    gyro: Floats  # (3,) rad/s
    accel: Floats  # (3,) m/s²
    covariance: Floats  # (6, 6) of both

    def at(self, stamp_ns: int, noise: ImuNoise) -> KnownBiases:
        """The same at a later time: biases walk."""
        walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3)
        grown = np.diag(1e-9 * (stamp_ns - self.stamp_ns) * walk**2)
        return self._replace(stamp_ns=stamp_ns, covariance=self.covariance + grown)


@frozen(eq=False)
class Estimate:
    """States, and what is known of their errors."""

    states: States  # n of them
    covariance: Floats  # (n, WIDTH, WIDTH)
    misfit: float  # root mean square of the normalised inertial and visual residuals
    has_converged: bool  # whether the iterations ended by themselves
    reduced: Floats  # (n, WIDTH, WIDTH) information on each state by what was measured before it
    reduced_gradient: Floats  # (n, WIDTH) the same of the gradient, at the states
    steps: Steps  # that it was made with
    evidence: float  # logarithm of the measurements' probability, but for a constant
    errors: MapErrors = MapErrors()  # of the states of one camera, those of `steps` or smaller

    def prior_of(self, row: int) -> Prior:
        """What the states before one say about it, for a chain that begins there."""
        return Prior(
            self.states.rows(slice(row, row + 1)), self.reduced[row], self.reduced_gradient[row]
        )

    def last_biases(self, stamp_ns: int) -> KnownBiases:
        """Biases of the last state, whose time is given."""
        both = slice(GYRO_BIAS.start, ACCEL_BIAS.stop)
        covariance = self.covariance[-1][both, both]
        return KnownBiases(
            stamp_ns, self.states.gyro_bias[-1], self.states.accel_bias[-1], covariance
        )


def first_prior(state: States, *, is_metric: bool, biases: KnownBiases | None = None) -> Prior:
    """What is known of the first state (1) of a world: its place and heading are chosen."""
    sigma = np.empty(WIDTH)
    sigma[ROTATION], sigma[POSITION], sigma[VELOCITY] = np.pi, _FIXED_M, _VELOCITY_M_S
    sigma[GYRO_BIAS], sigma[ACCEL_BIAS] = _GYRO_BIAS_RAD_S, _ACCEL_BIAS_M_S2
    sigma[LOG_SCALE] = _FIXED_LOG_SCALE if is_metric else _LOG_SCALE
    information = np.diag(sigma**-2.0)
    up = state.rotation[0].T[:, 2]  # the world's z axis in the sensor's frame
    information[ROTATION, ROTATION] += np.outer(up, up) / _FIXED_RAD**2
    about = state._replace(
        gyro_bias=np.zeros((1, 3)),
        accel_bias=np.zeros((1, 3)),
        log_scale=np.zeros(1) if is_metric else state.log_scale,
    )
    if biases is not None:
        both = slice(GYRO_BIAS.start, ACCEL_BIAS.stop)
        information[both, both] = np.linalg.inv(biases.covariance)
        about = about._replace(gyro_bias=biases.gyro[None], accel_bias=biases.accel[None])
    return Prior(about, information, np.zeros(WIDTH))


def estimate_states(
    states: States,
    steps: Steps,
    prior: Prior,
    noise: ImuNoise,
    last: Prior | None = None,
    *,
    last_step: float = _CONVERGED,
) -> Estimate:
    """Iterate from n states to the most probable ones, with priors of the first and the last.

    No iteration follows one whose steps are all smaller than `last_step` standard deviations.

    Raises:
        numpy.linalg.LinAlgError: the measurements do not determine the states.
    """
    return most_probable(ChainProblem(steps, prior, noise, last), states, last_step=last_step)


def most_probable(
    problem: ChainProblem, states: States, *, last_step: float = _CONVERGED
) -> Estimate:
    """The same with a problem.

    Raises:
        numpy.linalg.LinAlgError: the measurements do not determine the states.
    """
    for _ in range(_MAX_ITERATIONS):
        equations = problem.normal_equations(states)
        solution = solve_chain(equations)
        turn = float(np.abs(solution.step[:, ROTATION]).max())
        step = solution.step * min(1.0, _MAX_TURN_RAD / max(turn, 1e-12))
        states = states.moved(step)
        problem.follow(step)
        variance = np.diagonal(solution.covariance, axis1=1, axis2=2)
        largest = float((solution.step**2 / np.maximum(variance, 1e-24)).max())
        if largest < last_step**2:
            break
    # Covariances are those before the last step, and gradients follow it linearly.
    gradient = solution.reduced_gradient + (solution.reduced @ step[:, :, None])[..., 0]
    return Estimate(
        states,
        solution.covariance,
        problem.misfit,
        largest < last_step**2,
        solution.reduced,
        gradient,
        problem.steps,
        problem.evidence(equations, solution),
    )


def weighed_states(states: States, steps: Steps, prior: Prior, noise: ImuNoise) -> Estimate:
    """Most probable states, with the most probable errors of one camera's steps.

    Steps and covariances are those of the largest drift of the scale that is not improbable.

    Source: MacKay, "Bayesian interpolation", 1992 (evidence).
    """
    if steps.is_metric:
        return estimate_states(states, steps, prior, noise)

    def with_errors(errors: MapErrors, near: States) -> Estimate:
        return estimate_states(near, replace(steps, errors=errors), prior, noise)

    best = with_errors(MapErrors(*(values[0] for values in _MAP_ERRORS.values())), states)
    doubted = best
    for name, values in _MAP_ERRORS.items():
        for value in values[1:]:
            found = with_errors(best.steps.errors._replace(**{name: value}), best.states)
            if found.evidence < best.evidence - (_DOUBT if name == "drift" else 0.0):
                break
            best, doubted = (found if found.evidence > best.evidence else best), found
    errors, steps = best.steps.errors, doubted.steps
    return replace(best, covariance=doubted.covariance, steps=steps, errors=errors)


def with_weighed_images(estimate: Estimate, prior: Prior, noise: ImuNoise) -> Estimate:
    """The mean over parts of the variances of metric motions by images, each by its probability.

    These variances are meant to cover most scenes. They never grow, so that no sensor, however
    wrong, gets more weight than by them.

    Source: Hoeting et al., "Bayesian model averaging: a tutorial", 1999.
    """
    tried = [estimate]
    for part in PARTS:
        steps = replace(estimate.steps, covariance=part * estimate.steps.covariance)
        tried.append(estimate_states(tried[-1].states, steps, prior, noise))
    evidence = np.array([each.evidence for each in tried])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    off = np.stack([each.states.since(estimate.states) for each in tried])
    mean = np.tensordot(weight, off, 1)
    covariance = np.tensordot(weight, np.stack([each.covariance for each in tried]), 1)
    covariance += np.einsum("m,mni,mnj->nij", weight, off - mean, off - mean)
    best = tried[int(evidence.argmax())]
    return replace(best, states=estimate.states.moved(mean), covariance=covariance)


class ChainProblem:
    """Measurements of a chain, and their normal equations.

    Attributes:
        misfit: root mean square of all normalised residuals at the newest states, 0 without any.
        cost: sum of all weighed squares there.
        steps: all measurements.
        width: columns of the tangent of a state.
        inertial_rows: of the states before inertial motions.
        visual_rows: of those before motions by images.

    `errors`: of the motions by images, None for those of `image_errors`.
    """

    width = WIDTH

    def __init__(
        self,
        steps: Steps,
        prior: Prior,
        noise: ImuNoise,
        last: Prior | None = None,
        errors: tuple[Floats, Floats] | None = None,
    ) -> None:
        self.misfit = self.cost = 0.0
        self.steps, self._priors = steps, [(0, prior)]
        if last is not None:
            self._priors.append((len(steps.inertial), last))
        known = [k for k, m in enumerate(steps.inertial) if m is not None]
        self.inertial_rows = np.array(known, np.int64)
        self._missing = np.flatnonzero([m is None for m in steps.inertial])
        measured = [m for m in steps.inertial if m is not None]
        self.visual_rows = np.flatnonzero(steps.is_visual)
        self._visual_motions = steps.visual[self.visual_rows]
        if measured:
            self._motions = as_arrays(measured)
            self.inertial_information = np.array([m.information for m in measured])
        walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3)
        self._walk = np.maximum(np.sqrt(steps.duration_s)[:, None] * walk, _MIN_WALK)
        covariance, self._sigma_scale = image_errors(steps) if errors is None else errors
        self.visual_information = np.asarray(np.linalg.inv(covariance[self.visual_rows]))

    def normal_equations(self, states: States) -> Equations:
        """Normal equations of a step from these states."""
        equations = empty_equations(states.number, self.width)
        self.cost = 0.0
        for row, prior in self._priors:
            off = states.rows(slice(row, row + 1)).since(prior.at)[0]
            equations.before[row, :WIDTH, :WIDTH] += prior.information
            equations.gradient_before[row, :WIDTH] += prior.gradient + prior.information @ off
            self.cost += float(off @ (2.0 * prior.gradient + prior.information @ off))
        total, count = 0.0, 0
        if len(self.inertial_rows):
            inertial, information = self.inertial(states), self.inertial_information
            total += add_factors(self.inertial_rows, *inertial, information, np.inf, equations)
            count += inertial.residual.size
        self._add_walks(equations, states)
        if len(self.visual_rows):
            total += self._add_visual(equations, states)
            count += 6 * len(self.visual_rows)
        self._add_scale(equations, states)
        self.cost += total
        self.misfit = float(np.sqrt(total / count)) if count else 0.0
        return equations

    def follow(self, step: Floats) -> None:
        """Take the columns (n, width) of a step that are not of `States`."""

    def evidence(self, equations: Equations, solution: ChainSolution) -> float:
        """Logarithm of the measurements' probability, but for what `MapErrors` do not change."""
        determined = np.linalg.slogdet(solution.reduced + equations.after)[1].sum()
        assumed = np.linalg.slogdet(self.visual_information)[1].sum()
        assumed -= 2.0 * np.log(self._sigma_scale[self.steps.is_visual]).sum()
        return float(0.5 * (assumed - determined - self.cost))

    def inertial(self, states: States) -> Linearised:
        """Residuals of the inertial motions, of `inertial_rows`."""
        return inertial_residuals(*_ends(states, self.inertial_rows), self._motions)

    def visual(self, states: States) -> Linearised:
        """Residuals of the motions by images, of `visual_rows`."""
        ends = _ends(states, self.visual_rows)
        return visual_residuals(*ends, self._visual_motions, self.steps.imu_from_cam)

    def inertial_misfits(self, states: States) -> Floats:
        """Root mean squares of the normalised residuals of each inertial motion."""
        if not len(self.inertial_rows):
            return np.zeros(0)
        residual = self.inertial(states).residual
        squared = np.einsum("ni,nij,nj->n", residual, self.inertial_information, residual)
        return np.asarray(np.sqrt(squared.clip(0.0) / residual.shape[1]))

    def _add_visual(self, equations: Equations, states: States) -> float:
        """Add the motions by images; the sum of their squared normalised residuals."""
        visual, information = self.visual(states), self.visual_information
        return float(add_factors(self.visual_rows, *visual, information, HUBER, equations))

    def _add_walks(self, equations: Equations, states: States) -> None:
        """Biases walk; where samples are missing, the velocity may have any value."""
        change = np.diff(np.concatenate([states.gyro_bias, states.accel_bias], axis=1), axis=0)
        rows = np.arange(len(change))
        add_changes(rows, GYRO_BIAS.start, self._walk**-2.0, change, equations)
        self.cost += float(((change / self._walk) ** 2).sum())
        if len(self._missing):
            change = np.diff(states.velocity, axis=0)[self._missing]
            weight = np.full_like(change, _VELOCITY_M_S**-2.0)
            add_changes(self._missing, VELOCITY.start, weight, change, equations)

    def _add_scale(self, equations: Equations, states: States) -> None:
        """The scale drifts slowly within a segment; another segment has a scale of its own."""
        change = np.diff(states.log_scale)
        sigma = self._sigma_scale.copy()
        sigma[~self.steps.is_visual] = _LOG_SCALE
        if self.steps.is_metric:
            sigma[:] = _FIXED_LOG_SCALE
        weight = sigma[:, None] ** -2.0
        add_changes(np.arange(len(change)), LOG_SCALE, weight, change[:, None], equations)
        self.cost += float(((change / sigma) ** 2).sum())


def _ends(states: States, rows: Ints) -> tuple[States, States]:
    """The states of some rows, and those after them."""
    if len(rows) == states.number - 1:
        return states.rows(slice(0, -1)), states.rows(slice(1, None))
    return States(*(f[rows] for f in states)), States(*(f[rows + 1] for f in states))


def image_errors(steps: Steps) -> tuple[Floats, Floats]:
    """Of n motions by images: covariances (n, 6, 6) with the drift that the windows do not contain.

    And standard deviations (n,) of the change of the logarithm of the scale.
    """
    covariance = steps.covariance if steps.is_metric else without_scale(steps)
    turned_rad = np.linalg.norm(so3.log(steps.visual[:, :3, :3]), axis=1)
    drift = np.full(len(turned_rad), steps.errors.drift**2)
    drift[turned_rad > QUICK_RAD_S * steps.duration_s] += _TURN_LOG_SCALE**2
    return _visual_covariance(steps, covariance), np.sqrt(drift)


def _visual_covariance(steps: Steps, covariance: Floats) -> Floats:
    """Covariances with the drift that the windows do not contain."""
    covariance = covariance.copy()
    length = np.linalg.norm(steps.visual[:, :3, 3], axis=1)
    shortest = 1e-6 * max(float(length.max(initial=0.0)), 1e-6)
    ratio, angle = steps.errors.ratio, _STEP_RAD
    if steps.is_metric:
        ratio, angle = _METRIC_STEP_RATIO, _METRIC_STEP_RAD
    for axis in range(3):
        covariance[:, axis, axis] += angle**2
        covariance[:, axis + 3, axis + 3] += (ratio * length) ** 2 + shortest**2
    return covariance
