"""Whether images and inertial sensor agree: tests of an estimate of all states of a run.

Beside the residuals, it is asked what one more unknown would be, such as the magnitude of gravity,
or a scale of its own in a part of the run. Where images and samples agree, that is 0 within its
standard deviation; a sensor that is wrong, or that is moved by something that the images do not
see, such as a vehicle, shows there long before the residuals are large.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats
from vo.engine.inertial.chain_solver import Equations, empty_equations, solve_chain
from vo.engine.inertial.estimation import ChainProblem
from vo.engine.inertial.factor_kernels import add_factors
from vo.engine.inertial.states import GRAVITY_M_S2, LOG_SCALE, WIDTH, States

_MAX_MISFIT = 1.5  # of all steps; 0.3 to 0.7 in runs without faults
_MAX_STEP_MISFIT = 4.0  # of the samples of one step; at most 0.7 in runs without faults
_MAX_GAP_MISFIT = 2.5  # the same of a step that images do not lead across
_USUAL_MISFIT = 0.7  # with a larger one, standard deviations are larger in proportion
_MAX_SIGMA = 4.5
_CHANCE = 2.5  # largest deviation by chance, in standard deviations
# Smaller deviations are no contradiction: sensors and the noise model are not perfect.
_MIN_GRAVITY, _MIN_SCALE, _MIN_TILT_RAD = 0.02, 0.015, math.radians(0.25)
_MIN_STEPS = 4  # in a part of a run
_MAX_PARTS = 4


class Deviation(NamedTuple):
    """What one more unknown would be; 0 is expected."""

    value: float  # relative for the scale and for gravity's magnitude, radians for its direction
    sigma: float  # standard deviation


class Agreement(NamedTuple):
    """Result of all tests."""

    contradiction: str | None = None  # what contradicts the images, in words; None where they agree
    # by which standard deviations of states are too small, 1 where nothing shows it
    excess: float = 1.0


def agreement(problem: ChainProblem, states: States) -> Agreement:
    """Test the most probable states of a world."""
    test = _ScoreTest(problem, states)
    found = _of_residuals(problem, states)
    if found is not None or len(problem.inertial_rows) < 2 * _MIN_STEPS:
        return Agreement(found)
    excess = 1.0
    for deviation, least, text in _deviations(test, problem):
        sigma = deviation.sigma * max(1.0, problem.misfit / _USUAL_MISFIT)
        if abs(deviation.value) > max(least, _MAX_SIGMA * sigma):
            return Agreement(text)
        excess = max(excess, abs(deviation.value) / deviation.sigma)
    return Agreement(None, excess if excess > _CHANCE else 1.0)


def _of_residuals(problem: ChainProblem, states: States) -> str | None:
    if not problem.misfit <= _MAX_MISFIT:
        return (
            f"its samples differ from the images by {problem.misfit:.3g} times their noise (a hit, "
            "a bias that jumps, a wrong pose or clock, or a vehicle that accelerates?)"
        )
    rows, steps = problem.inertial_rows, problem.steps
    limit = np.where(steps.is_visual[rows], _MAX_STEP_MISFIT, _MAX_GAP_MISFIT)
    above = problem.inertial_misfits(states) > limit
    if above.any():
        at_s = float(steps.duration_s[: int(rows[above.argmax()])].sum())
        return f"its samples from {at_s:.1f} s of the path on are not the motion of the images"
    return None


def _deviations(test: _ScoreTest, problem: ChainProblem) -> Iterator[tuple[Deviation, float, str]]:
    """Deviations of further unknowns, how large they may always be, and what a larger one means."""
    gravity = test.of_gravity(np.array([0.0, 0.0, 1.0]))
    text = (
        f"gravity would be {gravity.value:+.1%} from {GRAVITY_M_S2} m/s² (wrong scale or bias of "
        "its accelerometer, or it is in a vehicle that accelerates)"
    )
    yield gravity, _MIN_GRAVITY, text
    for part in _parts(len(problem.steps.duration_s)):
        for axis in np.eye(3)[:2]:
            tilt = test.of_gravity(axis, part)
            text = (
                f"the direction of gravity changes by {math.degrees(abs(tilt.value)):.2g}° in a "
                "part of the run (its bias jumps, or it is in a vehicle that accelerates)"
            )
            yield tilt, _MIN_TILT_RAD, text
        if not problem.steps.is_metric:
            scale = test.of_scale(part)
            text = f"the scale of a part of the run would differ by {scale.value:+.1%}"
            yield scale, _MIN_SCALE, text


def _parts(count: int) -> Iterator[Bools]:
    """Which of so many steps belong to each part of a run."""
    number = min(_MAX_PARTS, count // _MIN_STEPS)
    part = np.arange(count) * number // count
    return (part == k for k in range(number))


class _ScoreTest:
    """Estimates one more unknown at the most probable states, by one linear step.

    Source: Rao, "Large sample tests of statistical hypotheses concerning several parameters", 1948.
    """

    def __init__(self, problem: ChainProblem, states: States) -> None:
        self._problem, self._states = problem, states
        self._equations = problem.normal_equations(states)

    def of_gravity(self, axis: Floats, part: Bools | None = None) -> Deviation:
        """Change of gravity against an axis of the world, in a part of the steps."""
        rows = self._problem.inertial_rows
        duration = self._problem.steps.duration_s[rows][:, None]
        change = GRAVITY_M_S2 * np.swapaxes(self._states.rotation[rows], 1, 2) @ axis
        if part is not None:
            change = change * part[rows][:, None]
        effect = np.zeros((len(rows), 9))
        effect[:, 3:6], effect[:, 6:] = change * duration, 0.5 * change * duration**2
        return self._deviation(effect, is_visual=False)

    def of_scale(self, part: Bools) -> Deviation:
        """Change of the logarithm of the scale in a part of the steps."""
        rows = self._problem.visual_rows
        effect = self._problem.visual(self._states).first[:, :, LOG_SCALE] * part[rows][:, None]
        return self._deviation(effect, is_visual=True)

    def _deviation(self, effect: Floats, *, is_visual: bool) -> Deviation:
        """That of an unknown with an effect (n, m) on the residuals of one kind."""
        problem = self._problem
        rows = problem.visual_rows if is_visual else problem.inertial_rows
        information = problem.visual_information if is_visual else problem.inertial_information
        found = (problem.visual if is_visual else problem.inertial)(self._states)
        added = empty_equations(self._states.number, WIDTH)
        own = add_factors(rows, effect, found.first, found.second, information, np.inf, added)
        gradient = float(np.einsum("ni,nij,nj->", effect, information, found.residual))
        before, after, coupling, *_ = self._equations
        gradients = added.gradient_before, added.gradient_after
        step = solve_chain(Equations(before, after, coupling, *gradients)).step
        # What is left of its information when all states may follow it.
        left = own + float((step * (gradients[0] + gradients[1])).sum())
        if not left > 1e-9 * own:
            return Deviation(0.0, math.inf)
        return Deviation(-gradient / left, left**-0.5)
