"""Refinement of two-view models: least squares of Sampson distances over a minimal set of numbers.

Derivatives are differences, as there are at most eight numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from vo.base.geometry.transforms import skew, so3_exp
from vo.base.types import Floats
from vo.engine.geometry import epipolar
from vo.engine.geometry.levenberg_marquardt import Law, minimise
from vo.tools.pairs.sampson import sampson

State = TypeVar("State")

_DIFFERENCE = 1e-7
_LAW = Law(15, 1e-9, damping=1e-6, least=1e-12, most=1e3, tries=15)


def refine_fundamental(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """The fundamental matrix nearby with the least sum of squared Sampson distances.

    Source: Bartoli and Sturm, "Nonlinear estimation of the fundamental matrix with minimal
    parameters", PAMI 2004: F = U diag(1, s, 0) V^T with rotations U and V.
    """
    to_first, to_second = _normalisation(first), _normalisation(second)
    normalised = np.linalg.inv(to_second).T @ fundamental @ np.linalg.inv(to_first)
    u, singular, vt = np.linalg.svd(normalised)
    u, v = u * np.linalg.det(u), vt.T * np.linalg.det(vt)
    start = _Singular(u, float(singular[1] / max(singular[0], 1e-30)), v)

    def matrix(state: _Singular) -> Floats:
        inner = (state.u * [1.0, state.ratio, 0.0]) @ state.v.T
        return np.asarray(to_second.T @ inner @ to_first)

    def move(state: _Singular, by: Floats) -> _Singular:
        u, v = state.u @ so3_exp(by[:3]), state.v @ so3_exp(by[3:6])
        return _Singular(u, state.ratio + float(by[6]), v)

    def residuals(state: _Singular) -> Floats:
        return sampson(matrix(state), first, second)

    result = matrix(minimise(_Differences(move, residuals, 7), start, _LAW))
    return np.asarray(result / np.linalg.norm(result))


class _Singular(NamedTuple):
    """A fundamental matrix u diag(1, ratio, 0) v^T of normalised pixels."""

    u: Floats
    ratio: float
    v: Floats


class Motion(NamedTuple):
    """A motion without scale: rotation (3, 3) and unit translation (3,), second from first."""

    rotation: Floats
    translation: Floats

    @property
    def essential(self) -> Floats:
        """(3, 3) essential matrix."""
        return skew(self.translation) @ self.rotation


def refine_motion(
    motion: Motion, first: Floats, second: Floats, matrices: tuple[Floats, Floats]
) -> Motion:
    """The motion nearby with the least sum of squared Sampson distances of pixels (N, 2).

    `first`: (N, 2) ideal pixels. `second`: (N, 2) ideal pixels. `matrices`: (3, 3) camera matrices
    of the first and the second image.
    """
    inverse_first, inverse_second = (np.linalg.inv(matrix) for matrix in matrices)

    def move(state: Motion, by: Floats) -> Motion:
        across = np.linalg.svd(state.translation[None])[2][1:]  # orthogonal to the translation
        turn = so3_exp(by[3:] @ across)
        return Motion(so3_exp(by[:3]) @ state.rotation, turn @ state.translation)

    def residuals(state: Motion) -> Floats:
        return sampson(inverse_second.T @ state.essential @ inverse_first, first, second)

    return minimise(_Differences(move, residuals, 5), motion, _LAW)


def refine_homography(homography: Floats, first: Floats, second: Floats) -> Floats:
    """The homography nearby with the least sum of squared transfer errors in both images."""
    to_first, to_second = _normalisation(first), _normalisation(second)
    from_second = np.linalg.inv(to_second)
    start = np.asarray(to_second @ homography @ np.linalg.inv(to_first), dtype=np.float64)

    def matrix(state: Floats) -> Floats:
        return np.asarray(from_second @ state @ to_first)

    def move(state: Floats, by: Floats) -> Floats:
        flat = state.ravel() / np.linalg.norm(state)
        moved = flat + by @ np.linalg.svd(flat[None])[2][1:]
        return np.asarray((moved / np.linalg.norm(moved)).reshape(3, 3), dtype=np.float64)

    def residuals(state: Floats) -> Floats:
        back = np.asarray(np.linalg.pinv(matrix(state)), dtype=np.float64)
        forward = epipolar.transferred(matrix(state), first) - second
        backward = epipolar.transferred(back, second) - first
        return np.concatenate([forward.ravel(), backward.ravel()])

    result = matrix(minimise(_Differences(move, residuals, 8), start, _LAW))
    return np.asarray(result / np.linalg.norm(result))


def _normalisation(xy: Floats) -> Floats:
    """Similarity (3, 3) to pixels with mean 0 and mean distance sqrt(2) (Hartley 1997)."""
    middle = xy.mean(axis=0)
    size = float(np.linalg.norm(xy - middle, axis=1).mean())
    scale = np.sqrt(2.0) / size if size > 0 else 1.0
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1.0]])


class _Differences(NamedTuple, Generic[State]):
    """A state with `size` numbers of `move`, and its residuals."""

    move: Callable[[State, Floats], State]
    residuals: Callable[[State], Floats]
    size: int

    def cost(self, state: State) -> float:
        """Sum of squares."""
        error = self.residuals(state)
        return float(error @ error)

    def steps(self, state: State) -> Callable[[float], Floats]:
        """Damped by the diagonal."""
        error = self.residuals(state)
        moved = [self.residuals(self.move(state, by)) for by in _DIFFERENCE * np.eye(self.size)]
        jacobian = np.stack([(each - error) / _DIFFERENCE for each in moved], axis=1)
        normal, right = jacobian.T @ jacobian, -jacobian.T @ error
        scale = np.diag(np.diag(normal) + 1e-12 * float(np.trace(normal)) + 1e-30)

        def step(damping: float) -> Floats:
            found = np.linalg.lstsq(normal + damping * scale, right, rcond=None)[0]
            return np.asarray(found, np.float64)

        return step

    def moved(self, state: State, step: Floats) -> State:
        """The state after a step."""
        return self.move(state, step)
