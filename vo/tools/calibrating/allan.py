"""Overlapping Allan deviation of a sensor at rest, and the noise terms that explain it.

Sources: IEEE Std 952-1997, annex C; Riley, "Handbook of frequency stability analysis", NIST 2008
(overlapping estimator); El-Sheimy et al., "Analysis and modeling of inertial sensors using Allan
variance", 2008.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from vo.base.types import Floats

_POINTS = 60
_MAX_CLUSTER = 0.1  # longest averaging time, of the recording
_ROUNDS = 4
_TERM_COST = 40.0  # improvement of the sum of squares that a further term must bring
_SHARED = 8.0  # variances of neighbouring points are of shared data
_FLAT = 2.0 * np.log(2.0) / np.pi


@dataclass(frozen=True, eq=False)
class AllanCurve:
    """Allan deviations of the axes of a sensor."""

    tau_s: Floats  # (M,) averaging times
    deviation: Floats  # (M, 3) of each axis
    freedom: Floats  # (M,) degrees of freedom of a variance, all axes together

    @property
    def pooled(self) -> Floats:
        """(M,) root mean square over the axes."""
        return np.asarray(np.sqrt(np.mean(self.deviation**2, axis=1)))


@dataclass(frozen=True)
class NoiseTerms:
    """Noise terms in the units of the measurements, per the root of Hz for density."""

    density: float  # white noise, the deviation at 1 s on the slope of -1/2
    density_sd: float  # its relative standard deviation
    walk: float  # random walk of the bias, on the slope of +1/2
    walk_sd: float  # its relative standard deviation; infinite if the recording does not show it
    instability: float  # lowest deviation of the flat part, 0 if there is none
    ramp: float  # rate of a drift, as of the temperature, on the slope of +1
    quantisation: float  # of the integral, on the slope of -1

    def deviation(self, tau_s: Floats) -> Floats:
        """(M,) Allan deviations of these terms."""
        squares = np.square(
            [self.quantisation, self.density, self.instability, self.walk, self.ramp]
        )
        return np.asarray(np.sqrt(_variances(tau_s) @ squares))


def allan_curve(values: Floats, rate_hz: float) -> AllanCurve:
    """Overlapping Allan deviations of measurements (N, 3) at constant intervals."""
    count = len(values)
    integral = np.zeros((count + 1, values.shape[1]))
    np.cumsum((values - values.mean(axis=0)) / rate_hz, axis=0, out=integral[1:])
    sizes = np.unique(
        np.geomspace(1, max(1, int(_MAX_CLUSTER * count)), _POINTS).round().astype(int)
    )
    deviation = []
    for size in sizes.tolist():
        second = integral[2 * size :] - 2.0 * integral[size:-size] + integral[: -2 * size]
        variance = np.mean(second**2, axis=0) / (2.0 * (size / rate_hz) ** 2)
        deviation.append(np.sqrt(variance))
    # Overlapping clusters add little to count / size independent ones (Riley, section 5.4).
    freedom = values.shape[1] * np.maximum(count / sizes - 1.0, 0.5)
    return AllanCurve(sizes / rate_hz, np.array(deviation), freedom)


def fit_terms(curve: AllanCurve) -> NoiseTerms:
    """The terms that explain the curve; each variance has the weight of its degrees of freedom."""
    variance, model = curve.pooled**2, _variances(curve.tau_s)
    expected = variance
    squares = np.zeros(model.shape[1])
    chosen: tuple[int, ...] = ()
    for _ in range(_ROUNDS):
        # An observed variance that is low by chance must not get a large weight.
        weight = np.sqrt(curve.freedom / 2.0) / expected
        squares, chosen = _non_negative(model * weight[:, None], variance * weight)
        expected = np.maximum(model @ squares, 1e-3 * variance)
    weight = np.sqrt(curve.freedom / 2.0) / expected
    shown = model[:, chosen] * weight[:, None]
    covariance = _SHARED * np.linalg.pinv(shown.T @ shown)
    sd = np.full(model.shape[1], np.inf)
    for row, term in enumerate(chosen):
        if squares[term] > 0.0:
            sd[term] = 0.5 * np.sqrt(covariance[row, row]) / squares[term]
    quantisation, density, instability, walk, ramp = np.sqrt(squares).tolist()
    return NoiseTerms(density, float(sd[1]), walk, float(sd[3]), instability, ramp, quantisation)


def _variances(tau_s: Floats) -> Floats:
    """(M, 5) variances of quantisation, density, instability, walk and ramp of size 1."""
    one = np.ones_like(tau_s)
    return np.stack([3.0 / tau_s**2, 1.0 / tau_s, _FLAT * one, tau_s / 3.0, tau_s**2 / 2.0], axis=1)


def _non_negative(matrix: Floats, right: Floats) -> tuple[Floats, tuple[int, ...]]:
    """Least squares with coefficients of 0 or more, and the positive ones; all subsets are tried.

    A subset of more terms is preferred only if it explains more than chance does.
    """
    best, found = np.inf, np.zeros(matrix.shape[1])
    chosen: tuple[int, ...] = ()
    for size in range(1, matrix.shape[1] + 1):
        for terms in combinations(range(matrix.shape[1]), size):
            part = matrix[:, terms]
            scale = np.linalg.norm(part, axis=0)
            solution = np.linalg.lstsq(part / scale, right, rcond=None)[0] / scale
            if (solution < 0.0).any():
                continue
            cost = float(np.sum((part @ solution - right) ** 2)) + _TERM_COST * size
            if cost < best:
                best, chosen = cost, terms
                found = np.zeros(matrix.shape[1])
                found[list(terms)] = solution
    return found, chosen
