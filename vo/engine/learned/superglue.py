"""Matches of two sets of features by SuperGlue, and its network as an ONNX graph.

Source: Sarlin et al., "SuperGlue: learning feature matching with graph neural networks", CVPR 2020,
section 3; the optimal transport (section 3.2) is not in the graph.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Floats, Floats32
from vo.engine.frontend.contracts import FeatureSet
from vo.engine.learned.graph import GraphBuilder, Tensor, attention, from_heads, linear, to_heads
from vo.engine.learned.inference import Inference
from vo.engine.learned.lightglue import Partners, partners_of

if TYPE_CHECKING:
    from onnx import ModelProto

MIN_PROBABILITY = 0.2  # the authors' threshold
_ITERATIONS = 100


class SuperGlue:
    """The assignment of SuperGlue, see `vo.engine.learned.lightglue.Assignment`.

    Features without a response, landmarks of the map, get the mean one of the other image.
    """

    def __init__(self, network: Inference) -> None:
        self._network = network

    def __call__(self, query: FeatureSet, train: FeatureSet) -> Partners:
        """See `vo.engine.learned.lightglue.Assignment`."""
        given = _inputs(query, train, 0) | _inputs(train, query, 1)
        similarity, bin_score = self._network.run(given, ["similarity", "bin_score"])
        found = log_assignment(similarity[0], float(bin_score.reshape(-1)[0]))
        return partners_of(found)


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


_HEADS = 4  # of each attention layer
_EPSILON = 1e-5  # of torch's batch normalisation


def superglue_model(weights: dict[str, Tensor]) -> ModelProto:
    """The model, from the weights by their names in the authors' file.

    Inputs `kpts0` (1, N, 2) and `kpts1` (1, M, 2) positions, 0 in the middle of the image and 1 at
    0.7 of its longer side, `scores0` and `scores1` (1, N or M, 1) responses of the detector,
    `desc0` and `desc1` (1, N or M, C) descriptors. Outputs: `similarity` (1, N, M) products of the
    matching descriptors (equation 7), `bin_score` (1,) the one of features without a match.

    Raises:
        KeyError: a weight is missing.
    """
    graph = GraphBuilder(weights)
    channels = graph.weight("final_proj.weight").shape[0]
    x = []
    for side in (0, 1):
        given = graph.node("Concat", f"kpts{side}", f"scores{side}", axis=-1)
        encoded = _perceptron(graph, "kenc.encoder", given)
        x.append(graph.node("Add", f"desc{side}", encoded))
    for number in range(_layers(weights)):
        name, is_cross = f"gnn.layers.{number}", number % 2 == 1
        sources = x[::-1] if is_cross else x
        messages = [_message(graph, name, *each) for each in zip(x, sources, strict=True)]
        x = [graph.node("Add", each, m) for each, m in zip(x, messages, strict=True)]
    scale = np.sqrt(np.sqrt(np.float64(channels)))
    weight, bias = _layer(graph, "final_proj")
    a, b = (linear(graph, each, weight / scale, bias / scale) for each in x)
    similarity = graph.node("MatMul", a, graph.node("Transpose", b, perm=[0, 2, 1]))
    bin_score = graph.node("Identity", graph.constant(graph.weight("bin_score").reshape(1)))
    counts = ("n", "m")
    inputs: dict[str, tuple[int | str, ...]] = {}
    for side, count in enumerate(counts):
        inputs[f"kpts{side}"] = (1, count, 2)
        inputs[f"scores{side}"] = (1, count, 1)
        inputs[f"desc{side}"] = (1, count, channels)
    outputs = {"similarity": (similarity, (1, *counts)), "bin_score": (bin_score, (1,))}
    return graph.model(inputs, outputs, "superglue")


def _layers(weights: dict[str, Tensor]) -> int:
    """Layers of attention, by turns within an image and between both."""
    return sum(name.endswith("attn.merge.weight") for name in weights)


def _layer(graph: GraphBuilder, name: str) -> tuple[Tensor, Tensor]:
    """Weight (out, in) and bias of a convolution of length 1."""
    return graph.weight(f"{name}.weight")[:, :, 0], graph.weight(f"{name}.bias")


def _message(graph: GraphBuilder, name: str, x: str, source: str) -> str:
    """What features (1, N, C) get from those of a source (equations 3 to 5)."""
    query, key, value = (
        to_heads(graph, linear(graph, each, *_by_head(graph, name, part)), _HEADS)
        for part, each in enumerate((x, source, source))
    )
    weight, bias = _layer(graph, f"{name}.attn.merge")
    order = _order(weight.shape[1])
    merged = from_heads(graph, attention(graph, query, key, value))
    message = linear(graph, merged, weight[:, order], bias)
    return _perceptron(graph, f"{name}.mlp", graph.node("Concat", x, message, axis=-1))


def _by_head(graph: GraphBuilder, name: str, part: int) -> tuple[Tensor, Tensor]:
    """A projection with channels ordered by head; queries (part 0) include the products' scale."""
    weight, bias = _layer(graph, f"{name}.attn.proj.{part}")
    order = _order(weight.shape[0])
    scale = np.sqrt(np.float64(weight.shape[0] // _HEADS)) if part == 0 else 1.0
    return weight[order] / scale, bias[order] / scale


def _order(channels: int) -> Tensor:
    """Channels by head: in the file, neighbouring channels belong to different heads."""
    return np.arange(channels).reshape(-1, _HEADS).T.reshape(-1)


def _perceptron(graph: GraphBuilder, name: str, x: str) -> str:
    """Layers 0, 3, 6, ... of a sequence, each but the last with normalisation and ReLU."""
    number = 0
    while True:
        weight, bias = (each.astype(np.float64) for each in _layer(graph, f"{name}.{number}"))
        norm = f"{name}.{number + 1}"
        if not graph.has_weight(f"{norm}.running_var"):
            return linear(graph, x, weight, bias)
        mean, variance, factor, term = (
            graph.weight(f"{norm}.{each}").astype(np.float64)
            for each in ("running_mean", "running_var", "weight", "bias")
        )
        scale = factor / np.sqrt(variance + _EPSILON)
        x = linear(graph, x, weight * scale[:, None], (bias - mean) * scale + term)
        x = graph.node("Relu", x)
        number += 3
