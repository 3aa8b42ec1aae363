"""A pose graph to be optimised: stored keyframes, the motions between them, and loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Bools, Floats, Ints
from vo.engine.places.records import Loop


@frozen(eq=False)
class GraphProblem:
    """Stored keyframes and loops between them, as plain arrays.

    Rows are keyframes. Those of a chain follow each other, in order of their keys.

    Attributes:
        keys: (n, 2) session and keyframe.
        chain: (n,) number of the chain of each: a segment, or a world of a loaded map.
        is_rigid: (n,) keyframes of a loaded map, which do not move relative to each other.
        is_metric: (n,) whether lengths of the chain are metres.
        is_inertial: (n,) whether `odom_from_cam` and `scale` are those by an inertial sensor, in
            metres; the scale drifts less then.
        odom_from_cam: (n, 4, 4) in the frame of the chain.
        scale: (n,) length in that frame of one unit of the keyframe's own segment; 1 except in
            loaded maps and by an inertial sensor.
        covariance: (n, 6, 6) of the motion since the row before, in this camera's frame, NaN if
            unknown; ignored in the first row of a chain, and where keyframes are rigid.
        is_doubted: (n,) whether that motion may be wrong by far more.
        doubted: ids of markers whose loops are false.
    """

    keys: Ints
    chain: Ints
    is_rigid: Bools
    is_metric: Bools
    is_inertial: Bools
    odom_from_cam: Floats
    scale: Floats
    covariance: Floats
    is_doubted: Bools
    loops: tuple[Loop, ...]
    doubted: tuple[int, ...] = ()

    @property
    def part(self) -> Ints:
        """(n,) number of the part of each row: the rows of a chain between doubted motions."""
        begins = self.is_doubted.copy()
        begins[:1] = True
        begins[1:] |= self.chain[1:] != self.chain[:-1]
        return np.asarray(np.cumsum(begins) - 1)


class Edges(NamedTuple):
    """Relations (E, 4, 4) of poses a and b (E,), with covariances (E, 7, 7) in the frame of b."""

    a: Ints
    b: Ints
    a_from_b: Floats
    covariance: Floats
