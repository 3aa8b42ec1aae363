"""Normal equations of the poses of a path, of which most have no landmark in common.

The poses are ordered by levels: those of a level are coupled with the next and the previous one at
most, so that the matrix is block tridiagonal. Time and memory grow with the length of the path, and
with the third and second power of the number of poses that see the same.

Source: George, "Nested Dissection of a Regular Finite Element Mesh", 1973 (level structures);
Rauch, Tung, Striebel, "Maximum Likelihood Estimates of Linear Dynamic Systems", 1965 (covariances
of a chain).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.block_matrix import BLOCK, LANES, assembled
from vo.engine.geometry.points import by_points

_LEAST_DIAGONAL = 1e-9  # that is damped, relative to the greatest


class Levels(NamedTuple):
    """An order of K poses, of which the first stays the first and is held.

    Attributes:
        order: (K,) row that each pose has elsewhere.
        place: (K,) the inverse.
        begins: (L + 1,) first pose of each of L levels, and K.
        row: (K + 1,) block (a, b) of the matrix has the number row[a] + b.
        end: (K + 1,) of the next level but one: poses from there on are not coupled with the pose.
    """

    order: Ints
    place: Ints
    begins: Ints
    row: Ints
    end: Ints

    @property
    def width(self) -> int:
        """Number of poses in adjacent levels, the most."""
        return int((self.end - np.arange(len(self.end)))[1:].max())


def coupled_poses(point_ok: Bools, point: Ints, keyframe: Ints, count: int) -> Bools:
    """(K, K) which poses observe an ok landmark in common, by N observations."""
    starts, order = by_points(point_ok, point)
    return np.asarray(_coupled(starts, keyframe[order], count))


def levels_of(coupled: Bools) -> Levels:
    """Levels by distance from a pose that is as far as possible from the second one."""
    count = len(coupled)
    farthest = _by_distance(coupled, 1)[-1][-1]
    levels = _by_distance(coupled, int(farthest))
    begins = np.cumsum([1, *(len(level) for level in levels)])
    # The held pose is no level: it has the blocks of all others.
    end = np.repeat(np.append(begins[2:], count), np.diff(begins))
    end = np.r_[count, end, count]
    # After each row the block of parameters that all poses have in common.
    stored = end - np.arange(count + 1) + 1
    row = np.cumsum(stored) - stored - np.arange(count + 1)
    order = np.concatenate([[0], *levels])
    return Levels(order, np.argsort(order), begins, row, end)


def _by_distance(coupled: Bools, root: int) -> list[Ints]:
    """All poses but the first, by the number of steps to one of them."""
    left = np.arange(len(coupled)) > 0
    levels, found = [], np.array([root])
    while left.any():
        if len(found) == 0:  # not connected
            found = np.flatnonzero(left)[:1]
        left[found] = False
        levels.append(found)
        found = np.flatnonzero(coupled[found].any(axis=0) & left)
    return levels


@compiled
def _coupled(starts, keyframe, count):  # type: ignore[no-untyped-def]
    coupled = np.zeros((count, count), dtype=np.bool_)
    for m in range(len(starts) - 1):
        for a in range(starts[m], starts[m + 1]):
            for b in range(starts[m], starts[m + 1]):
                coupled[keyframe[a], keyframe[b]] = True
    return coupled


class _Eliminated(NamedTuple):
    """A level after the elimination of those before it: x[rows] = y - gain @ x[next rows]."""

    rows: slice
    matrix: Floats
    gain: Floats


class PathEquations:
    """The matrix H of the poses, and its solutions with the first one held.

    Attributes:
        levels: the order of the poses.
    """

    def __init__(self, levels: Levels, flat: Floats) -> None:
        self.levels, self._flat = levels, flat
        self._blocks = flat.reshape(-1, BLOCK // LANES, LANES)[:, :, :6]

    def add(self, a: int, b: int, block: Floats) -> None:
        """Add the (6, 6) that couples pose a with pose b, which is not before it."""
        self._blocks[self.levels.row[a] + b] += block

    def shared(self) -> tuple[Floats, Floats]:
        """Of six parameters that all poses have in common: (6 K - 6, 6) coupling, own (6, 6)."""
        number = (self.levels.row + self.levels.end)[1:]
        return self._blocks[number[:-1]].reshape(-1, 6), self._blocks[number[-1]]

    def dense(self) -> Floats:
        """(6 K - 6, 6 K - 6) H of all poses but the first, in their order elsewhere."""
        order, count = self.levels.order, len(self.levels.order)
        result = np.zeros((count, 6, count, 6))
        for a in range(1, count):
            coupled = np.arange(a, self.levels.end[a])
            blocks = self._blocks[self.levels.row[a] + coupled]
            result[order[a], :, order[coupled]] = blocks
            result[order[coupled], :, order[a]] = np.swapaxes(blocks, 1, 2)
        return result[1:, :, 1:].reshape(6 * count - 6, 6 * count - 6)

    def solve(self, right: Floats, damping: float = 0.0) -> Floats:
        """(6 K - 6, n) x with (H + damping diag(H)) x = right.

        Raises:
            numpy.linalg.LinAlgError: it is singular.
        """
        result = right.copy()
        levels = self._eliminated(result, damping)
        for level, after in reversed(list(pairwise(levels))):
            result[level.rows] -= level.gain @ result[after.rows]
        return result

    def covariances(self) -> Floats:
        """(K, 6, 6) blocks on the diagonal of the inverse of H.

        Raises:
            numpy.linalg.LinAlgError: it is not positive definite.
        """
        count = len(self.levels.order)
        found, whole = np.zeros((count, 6, 6)), np.zeros((0, 0))
        for level in reversed(self._eliminated(np.zeros((6 * count - 6, 0)), 0.0)):
            np.linalg.cholesky(level.matrix)
            whole = np.linalg.inv(level.matrix) + level.gain @ whole @ level.gain.T
            whole = 0.5 * (whole + whole.T)
            first, poses = level.rows.start // 6 + 1, np.arange(len(whole) // 6)
            found[first + poses] = whole.reshape(-1, 6, len(poses), 6)[poses, :, poses]
        return found

    def _eliminated(self, right: Floats, damping: float) -> list[_Eliminated]:
        """All levels; `right` becomes y."""
        row, begins, count = self.levels.row, self.levels.begins, len(self.levels.order)
        own = self._blocks[row[1:count] + np.arange(1, count)]
        diagonal = np.diagonal(own, axis1=1, axis2=2).ravel()
        added = damping * np.maximum(diagonal, _LEAST_DIAGONAL * diagonal.max())
        done: list[_Eliminated] = []
        below = np.zeros((0, 0))
        for first, last, end in zip(begins, begins[1:], [*begins[2:], count], strict=False):
            rows, size = slice(6 * first - 6, 6 * last - 6), 6 * (last - first)
            both = assembled(self._flat, row, first, last, end)
            matrix, coupling = both[:, :size], both[:, size:]
            matrix[np.arange(size), np.arange(size)] += added[rows]
            if done:
                matrix = matrix - below.T @ done[-1].gain
                right[rows] -= below.T @ right[done[-1].rows]
            solved = np.linalg.solve(matrix, np.hstack([coupling, right[rows]]))
            gain, right[rows] = np.split(solved, [coupling.shape[1]], axis=1)
            done.append(_Eliminated(rows, matrix, gain))
            below = coupling
        return done
