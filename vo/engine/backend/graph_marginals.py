"""Covariances of the poses of a graph, of single ones and of pairs that share an edge.

`gtsam.Marginals` begins anew for each pair. Here all of them follow from one elimination, from its
last pose back: those of a pose and of the poses that it depends on are found from the latter.

Source: Kaess and Dellaert, "Covariance recovery from a square root information matrix for data
    association", Robotics and Autonomous Systems 57(12), 2009, sec. 4 (after Golub and Plemmons).
"""

from __future__ import annotations

import gtsam
import numpy as np

from vo.base.types import Floats, Ints

_SIZE = 7  # of the tangent of a pose


def pose_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, a: Ints, b: Ints
) -> tuple[Floats, Floats]:
    """Covariances of all poses (m, 7, 7), and of pairs of them (E, 14, 14), each in its own frame.

    A factor of the graph connects each pair of poses `a` (E,) and `b` (E,).
    """
    linear = graph.linearize(values)
    net = linear.eliminateSequential(gtsam.Ordering.ColamdGaussianFactorGraph(linear))
    count = values.size()
    known = np.zeros((_SIZE * count, _SIZE * count))  # only blocks that an edge connects are filled
    for number in range(net.size() - 1, -1, -1):
        conditional = net.at(number)
        pose, *parents = conditional.keys()
        at = slice(_SIZE * pose, _SIZE * (pose + 1))
        inverse = np.linalg.inv(conditional.R())
        known[at, at] = inverse @ inverse.T
        if parents:
            others = (_SIZE * np.array(parents)[:, None] + np.arange(_SIZE)).reshape(-1)
            gain = -inverse @ conditional.S()
            with_parents = gain @ known[np.ix_(others, others)]
            known[at, at] += with_parents @ gain.T
            known[at, others], known[others, at] = with_parents, with_parents.T
    blocks = known.reshape(count, _SIZE, count, _SIZE)
    every = np.arange(count)
    single = blocks[every, :, every]
    rows = np.stack([a, b], axis=1)
    pairs = blocks[rows[:, :, None], :, rows[:, None, :]]
    return single, np.swapaxes(pairs, 2, 3).reshape(-1, 2 * _SIZE, 2 * _SIZE)
