"""Parts of transformers over sets of features as ONNX nodes.

Source: Vaswani et al., "Attention is all you need", NeurIPS 2017, sections 3.2 and 3.3.
"""

from __future__ import annotations

import numpy as np

from vo.engine.learned.graph import GraphBuilder
from vo.engine.learned.torch_archive import Tensor

_EPSILON = 1e-5  # of torch's layer normalisation


def linear(graph: GraphBuilder, x: str, weight: Tensor, bias: Tensor) -> str:
    """(1, N, out) of (1, N, in), from a weight (out, in)."""
    product = graph.node("MatMul", x, graph.constant(np.ascontiguousarray(weight.T)))
    return graph.node("Add", product, graph.constant(bias))


def named_linear(graph: GraphBuilder, name: str, x: str) -> str:
    """A linear layer by its name in the weights."""
    return linear(graph, x, graph.weight(f"{name}.weight"), graph.weight(f"{name}.bias"))


def to_heads(graph: GraphBuilder, x: str, heads: int) -> str:
    """(1, heads, N, C / heads) of (1, N, C), whose channels are ordered by head."""
    parts = graph.node("Reshape", x, graph.constant([0, 0, heads, -1], np.int64))
    return graph.node("Transpose", parts, perm=[0, 2, 1, 3])


def from_heads(graph: GraphBuilder, x: str) -> str:
    """(1, N, C) of (1, heads, N, C / heads)."""
    parts = graph.node("Transpose", x, perm=[0, 2, 1, 3])
    return graph.node("Reshape", parts, graph.constant([0, 0, -1], np.int64))


def attention(graph: GraphBuilder, query: str, key: str, value: str) -> str:
    """Values averaged by the softmax of products of queries and keys, which include the scale.

    Shapes (1, heads, N, d), (1, heads, M, d), (1, heads, M, d); result (1, heads, N, d).
    """
    transposed = graph.node("Transpose", key, perm=[0, 1, 3, 2])
    weight = graph.node("Softmax", graph.node("MatMul", query, transposed), axis=-1)
    return graph.node("MatMul", weight, value)


def layer_normalised(graph: GraphBuilder, name: str, x: str) -> str:
    """Zero mean and unit variance over the channels, then weight and bias.

    Source: Ba et al., "Layer normalization", 2016.
    """
    weight, bias = graph.weight(f"{name}.weight"), graph.weight(f"{name}.bias")
    return graph.node(
        "LayerNormalization",
        x,
        graph.constant(weight),
        graph.constant(bias),
        axis=-1,
        epsilon=_EPSILON,
    )


def gelu(graph: GraphBuilder, x: str) -> str:
    """`x` times the normal distribution function of x (Hendrycks and Gimpel 2016, equation 1)."""
    erf = graph.node("Erf", graph.node("Div", x, graph.constant(np.sqrt(2.0))))
    doubled = graph.node("Mul", x, graph.node("Add", erf, graph.constant(1.0)))
    return graph.node("Mul", doubled, graph.constant(0.5))
