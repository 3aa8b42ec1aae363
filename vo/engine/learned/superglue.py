"""Matches of two sets of features by SuperGlue.

Source: Sarlin et al., "SuperGlue: learning feature matching with graph neural networks", CVPR 2020.
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats, Floats32
from vo.engine.frontend.contracts import FeatureSet
from vo.engine.learned.inference import Inference

MIN_PROBABILITY = 0.2  # the authors' threshold
_ITERATIONS = 100


class SuperGlue:
    """The assignment of SuperGlue, see `vo.engine.learned.lightglue.Assignment`.

    Features without a response, landmarks of the map, get the mean one of the other image.
    """

    def __init__(self, network: Inference) -> None:
        self._network = network

    def __call__(self, query: FeatureSet, train: FeatureSet) -> Floats:
        """See `vo.engine.learned.lightglue.Assignment`."""
        given = _inputs(query, train, 0) | _inputs(train, query, 1)
        similarity, bin_score = self._network.run(given, ["similarity", "bin_score"])
        return log_assignment(similarity[0], float(bin_score.reshape(-1)[0]))


def _inputs(features: FeatureSet, other: FeatureSet, side: int) -> dict[str, Floats32]:
    """Inputs of the network for one of the two images."""
    if features.size is None or features.xy is None:
        raise ValueError("features have no image size; matching by a network needs it")
    response = features.response
    if response is None:
        usual = 1.0 if other.response is None else float(other.response.mean())
        response = np.full(len(features), usual, np.float32)
    return {
        f"kpts{side}": normalised(features.xy, features.size)[None],
        f"scores{side}": response.astype(np.float32)[None, :, None],
        f"desc{side}": np.ascontiguousarray(features.descriptor, np.float32)[None],
    }


def normalised(xy: Floats | Floats32, size: tuple[int, int]) -> Floats32:
    """Positions (N, 2), 0 in the middle of an image (width, height), 1 at 0.7 longer sides."""
    return ((xy - np.divide(size, 2.0)) / (0.7 * max(size))).astype(np.float32)


def log_assignment(similarity: Floats32, bin_score: float) -> Floats:
    """Logarithms of the assignment (N, M) by optimal transport (section 3.2).

    Features without a match go to one more row and column, the bins. Every feature is assigned
    once; the bins take as many as there are features on the other side.

    Source: Sinkhorn and Knopp, "Concerning nonnegative matrices and doubly stochastic matrices",
    1967; here 100 iterations.

    Args:
        similarity: (N, M) of each pair.
        bin_score: similarity of a feature to the bin.
    """
    rows, columns = similarity.shape
    scores = np.full((rows + 1, columns + 1), bin_score, np.float64)
    scores[:-1, :-1] = similarity
    # Row by row relative to the largest, so that the exponential neither overflows nor vanishes.
    highest = scores.max(axis=1)
    kernel = np.exp(scores - highest[:, None])
    row_sums, column_sums = np.ones(rows + 1), np.ones(columns + 1)
    row_sums[-1], column_sums[-1] = columns, rows
    v = np.ones(columns + 1)
    for _ in range(_ITERATIONS):
        u = row_sums / (kernel @ v)
        v = column_sums / (u @ kernel)
    with np.errstate(divide="ignore"):
        log = scores - highest[:, None] + np.log(u)[:, None] + np.log(v)
    return np.asarray(log[:-1, :-1])
