"""Sparse symmetric matrices of 7 x 7 blocks: solutions, and blocks of the inverse.

Poses are eliminated one after the other, first the one that is coupled with the fewest others.
Blocks of the inverse follow from the last one back.

Source: George and Liu, "The Evolution of the Minimum Degree Ordering Algorithm", 1989; Kaess and
Dellaert, "Covariance recovery from a square root information matrix for data association",
Robotics and Autonomous Systems 57(12), 2009, sec. 4 (after Golub and Plemmons).
"""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats, Ints
from vo.engine.inertial.chain_solver import add_product, invert_into

_SIZE = 7


class Couplings:
    """Which of m poses are coupled, by edges between poses `a` (E,) and `b` (E,).

    Of a pose with itself, a and b are the same. A matrix is (m + n, 7, 7): blocks on the diagonal,
    and under it, in the order of elimination.
    """

    def __init__(self, count: int, a: Ints, b: Ints) -> None:
        coupled = np.zeros((count, count), bool)
        coupled[a, b] = coupled[b, a] = True
        np.fill_diagonal(coupled, False)
        left, degree = np.ones(count, bool), coupled.sum(axis=1)
        order, columns = np.zeros(count, np.int64), []
        for n in range(count):
            order[n] = pose = int(np.argmin(np.where(left, degree, count)))
            left[pose] = False
            columns.append(np.flatnonzero(coupled[pose] & left))
            coupled[np.ix_(columns[-1], columns[-1])] = True
            coupled[columns[-1], columns[-1]] = False
            degree[columns[-1]] = (coupled[columns[-1]] & left).sum(axis=1)
        self._place = np.argsort(order)
        self._starts = np.cumsum([0, *(len(column) for column in columns)])
        self._below = np.concatenate([np.sort(self._place[column]) for column in columns])
        self._is_turned = self._place[a] < self._place[b]
        self._rows = self._blocks(*np.sort([self._place[a], self._place[b]], axis=0))
        self._numbers = (_SIZE**2 * self._rows[:, None] + np.arange(_SIZE**2)).ravel()

    def _blocks(self, first: Ints, last: Ints) -> Ints:
        """Numbers of the blocks that couple two places."""
        count = len(self._place)
        column = np.repeat(np.arange(count), np.diff(self._starts))
        number = count + np.searchsorted(column * count + self._below, first * count + last)
        return np.where(first == last, first, number)

    def matrix(self, blocks: Floats) -> Floats:
        """The sum of blocks (E, 7, 7) of rows of a and columns of b."""
        turned = np.where(self._is_turned[:, None, None], np.swapaxes(blocks, 1, 2), blocks)
        size = _SIZE**2 * (len(self._place) + len(self._below))
        summed = np.bincount(self._numbers, turned.ravel(), size)
        return np.asarray(summed.reshape(-1, _SIZE, _SIZE), np.float64)

    def solve(self, matrix: Floats, diagonal: Floats, right: Floats) -> tuple[Floats, float]:
        """(m, 7) x with (H + diag(diagonal)) x = right, both (m, 7); logarithm of the determinant.

        Raises:
            numpy.linalg.LinAlgError: it is not positive definite.
        """
        gain, inverse = self._eliminated(matrix, diagonal)
        result = right[np.argsort(self._place)]
        _substitute(self._starts, self._below, gain, inverse, result)
        return np.asarray(result[self._place]), -float(np.linalg.slogdet(inverse)[1].sum())

    def inverse_blocks(self, matrix: Floats, diagonal: Floats) -> tuple[Floats, Floats]:
        """Of H + diag(diagonal): (m, 7, 7) of poses, and (E, 7, 7) of rows of a and columns of b.

        Raises:
            numpy.linalg.LinAlgError: it is not positive definite.
        """
        gain, inverse = self._eliminated(matrix, diagonal)
        found = np.zeros_like(matrix)
        _invert(self._starts, self._below, gain, inverse, found)
        between = found[self._rows]
        turned = np.where(self._is_turned[:, None, None], np.swapaxes(between, 1, 2), between)
        return found[self._place], turned

    def _eliminated(self, matrix: Floats, diagonal: Floats) -> tuple[Floats, Floats]:
        blocks, count = matrix.copy(), len(self._place)
        axes = np.arange(_SIZE)
        blocks[self._place[:, None], axes, axes] += diagonal
        gain, inverse = np.zeros_like(blocks[count:]), np.zeros_like(blocks[:count])
        if not _eliminate(blocks, self._starts, self._below, gain, inverse):
            raise np.linalg.LinAlgError("not positive definite")
        return gain, inverse


@compiled
def _eliminate(blocks, starts, below, gain, inverse):  # type: ignore[no-untyped-def]
    """Eliminate all poses in turn; whether the matrix is positive definite."""
    count = len(starts) - 1
    lower, scale = np.empty((_SIZE, _SIZE)), np.empty(_SIZE)
    for k in range(count):
        if not invert_into(blocks[k], scale, lower, inverse[k]):
            return False
        for p in range(starts[k], starts[k + 1]):
            add_product(blocks[count + p], inverse[k], gain[p])
        for p in range(starts[k], starts[k + 1]):
            for q in range(p, starts[k + 1]):
                at = _block(starts, below, below[q], below[p])
                for i in range(_SIZE):
                    for j in range(_SIZE):
                        total = 0.0
                        for m in range(_SIZE):
                            total += gain[q, i, m] * blocks[count + p, j, m]
                        blocks[at, i, j] -= total
    return True


@compiled
def _substitute(starts, below, gain, inverse, result):  # type: ignore[no-untyped-def]
    """Solve for what is in `result`, (m, 7) in the order of elimination."""
    for k in range(len(starts) - 1):
        for p in range(starts[k], starts[k + 1]):
            for i in range(_SIZE):
                for j in range(_SIZE):
                    result[below[p], i] -= gain[p, i, j] * result[k, j]
    own = np.empty(_SIZE)
    for k in range(len(starts) - 2, -1, -1):
        for i in range(_SIZE):  # rows assigned as a whole take a second to compile
            own[i], result[k, i] = result[k, i], 0.0
        for i in range(_SIZE):
            for j in range(_SIZE):
                result[k, i] += inverse[k, i, j] * own[j]
                for p in range(starts[k], starts[k + 1]):
                    result[k, i] -= gain[p, j, i] * result[below[p], j]


@compiled
def _invert(starts, below, gain, inverse, found):  # type: ignore[no-untyped-def]
    """Blocks of the inverse where the factors have some, in `found`."""
    count, other = len(starts) - 1, np.empty((_SIZE, _SIZE))
    for k in range(count - 1, -1, -1):
        for i in range(_SIZE):
            for j in range(_SIZE):
                found[k, i, j] = inverse[k, i, j]
        for p in range(starts[k], starts[k + 1]):
            for q in range(starts[k], starts[k + 1]):
                row, column = max(below[p], below[q]), min(below[p], below[q])
                at = _block(starts, below, row, column)
                for i in range(_SIZE):
                    for j in range(_SIZE):
                        other[i, j] = -found[at, i, j] if p >= q else -found[at, j, i]
                add_product(other, gain[q], found[count + p])
            for i in range(_SIZE):
                for j in range(_SIZE):
                    for m in range(_SIZE):
                        found[k, i, j] -= gain[p, m, i] * found[count + p, m, j]


@compiled(**NO_REFCOUNT)
def _block(starts, below, row, column):  # type: ignore[no-untyped-def]
    """Number of a block on or under the diagonal."""
    if row == column:
        return row
    first, last = starts[column], starts[column + 1]
    while last - first > 1:
        middle = (first + last) // 2
        if below[middle] <= row:
            first = middle
        else:
            last = middle
    return len(starts) - 1 + first
