"""Symmetric matrices of blocks of 6 x 6, of which those on and above the diagonal are stored.

They are in one flat array, row of blocks by row; a block is 6 rows, each padded to the 8 numbers of
a vector register.
"""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled

LANES = 8
BLOCK = 6 * LANES


@compiled
def assembled(blocks, row, first, last, end):  # type: ignore[no-untyped-def]
    """Rows of the poses from first to last - 1 of a symmetric matrix, in columns up to end - 1.

    The columns of poses before the first are left out. `row`: (K,) block (a, b) has the number
    row[a] + b.
    """
    size, columns = 6 * (last - first), 6 * (end - first)
    matrix = np.zeros((size, columns))
    for r in range(size):
        a, c = divmod(r, 6)
        for column in range(r, columns):
            b, e = divmod(column, 6)
            block = BLOCK * (row[first + a] + first + b)
            matrix[r, column] = blocks[block + LANES * c + e]
            if column < size:
                matrix[column, r] = matrix[r, column]
    return matrix
