"""Normal equations of a chain of states that all depend on a few common unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Floats


@dataclass(eq=False)
class BorderedSystem:
    """Normal equations of N states with S unknowns each, and of C common unknowns."""

    diagonal: Floats  # (N, S, S)
    next: Floats  # (N - 1, S, S) between a state and the next one
    border: Floats  # (N, S, C) between a state and the common unknowns
    corner: Floats  # (C, C)
    right: Floats  # (N, S) gradient of the states
    right_common: Floats  # (C,) that of the common unknowns

    @classmethod
    def empty(cls, count: int, size: int, common: int) -> BorderedSystem:
        """All zero."""
        return cls(
            np.zeros((count, size, size)),
            np.zeros((count - 1, size, size)),
            np.zeros((count, size, common)),
            np.zeros((common, common)),
            np.zeros((count, size)),
            np.zeros(common),
        )

    def solve(self, damping: float) -> tuple[Floats, Floats, Floats]:
        """Eliminate the states one by one.

        Returns (N, S) steps of the states, (C,) step of the common unknowns, and the (C, C)
        information of the common unknowns.
        """
        count, size = self.right.shape
        common = len(self.right_common)
        known = np.concatenate([self.border, self.right[:, :, None]], axis=2)
        damped = self.diagonal * (1.0 + damping * np.eye(size))
        solved = np.zeros((count, size, size + common + 1))
        corner = self.corner * (1.0 + damping * np.eye(common))
        right_common = self.right_common.copy()
        block, rest = damped[0], known[0]
        for k in range(count):
            following = self.next[k] if k + 1 < count else np.zeros((size, size))
            solved[k] = np.linalg.solve(block, np.hstack([following, rest]))
            corner = corner - rest[:, :common].T @ solved[k][:, size:-1]
            right_common = right_common - rest[:, :common].T @ solved[k][:, -1]
            if k + 1 < count:
                block = damped[k + 1] - following.T @ solved[k][:, :size]
                rest = known[k + 1] - following.T @ solved[k][:, size:]
        of_common = np.linalg.solve(corner, right_common)
        of_states = np.zeros((count, size))
        after = np.zeros(size)
        for k in range(count - 1, -1, -1):
            after = (
                solved[k][:, -1] - solved[k][:, size:-1] @ of_common - solved[k][:, :size] @ after
            )
            of_states[k] = after
        return of_states, np.asarray(of_common), corner
