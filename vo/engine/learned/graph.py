"""A small builder of ONNX graphs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vo.base.extras import require

if TYPE_CHECKING:
    from onnx import ModelProto

Tensor = NDArray[np.generic]

_OPSET = 17
_IR_VERSION = 8  # of ONNX Runtime 1.14 and OpenCV 5
_EPSILON = 1e-5  # of torch's normalisation layers


class GraphBuilder:
    """Collects nodes and weights; each method returns the name of its output."""

    def __init__(self, weights: dict[str, Tensor]) -> None:
        require("onnx", extra="learned", what="model files")
        self._weights = weights
        self._nodes: list[Any] = []
        self._constants: dict[str, Any] = {}
        self._names: dict[tuple[Any, ...], str] = {}

    def node(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add an operator with one output."""
        from onnx import helper

        output = f"{operator.lower()}_{len(self._nodes)}"
        self._nodes.append(helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def constant(self, values: Any, dtype: Any = np.float32) -> str:
        """Add a constant; equal ones are stored once."""
        from onnx import numpy_helper

        array = np.asarray(values, dtype=dtype)
        key = (array.dtype, array.shape, array.tobytes())
        if key not in self._names:
            name = self._names[key] = f"constant_{len(self._constants)}"
            self._constants[name] = numpy_helper.from_array(array, name)
        return self._names[key]

    def weight(self, name: str) -> Tensor:
        """A tensor of the weights by its name there."""
        return self._weights[name]

    def has_weight(self, name: str) -> bool:
        """Whether the weights have a tensor of this name."""
        return name in self._weights

    def convolution(
        self, x: str, weight: Tensor, bias: Tensor | None, stride: int = 1, padding: int = 0
    ) -> str:
        """A two-dimensional convolution."""
        inputs = [x, self.constant(weight)]
        if bias is not None:
            inputs.append(self.constant(bias))
        side = weight.shape[2]
        return self.node(
            "Conv",
            *inputs,
            kernel_shape=[side, side],
            strides=[stride] * 2,
            pads=[padding] * 4,
        )

    def normalised(
        self,
        weight: Tensor,
        mean: Tensor,
        variance: Tensor,
        affine: tuple[Tensor, Tensor] | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Weight and bias of a convolution with the batch normalisation after it folded in.

        Args:
            weight: of the convolution, which has no bias.
            mean: running mean of the normalisation.
            variance: its running variance.
            affine: its factor and its term, if it has them.
        """
        scale = 1.0 / np.sqrt(variance.astype(np.float64) + _EPSILON)
        bias = -mean.astype(np.float64) * scale
        if affine is not None:
            factor, term = (a.astype(np.float64) for a in affine)
            scale, bias = scale * factor, bias * factor + term
        folded = weight.astype(np.float64) * scale[:, None, None, None]
        return folded.astype(np.float32), bias.astype(np.float32)

    def model(
        self,
        inputs: Mapping[str, Sequence[int | str]],
        outputs: Mapping[str, tuple[str, Sequence[int | str]]],
        name: str,
    ) -> ModelProto:
        """The finished model.

        Args:
            inputs: shape of each input; words stand for any size.
            outputs: for each output, the node that gives it, and its shape.
            name: of the graph.
        """
        from onnx import TensorProto, checker, helper

        kind = TensorProto.FLOAT
        named = [
            helper.make_node("Identity", [node], [output]) for output, (node, _) in outputs.items()
        ]
        graph = helper.make_graph(
            [*self._nodes, *named],
            name,
            [helper.make_tensor_value_info(n, kind, list(s)) for n, s in inputs.items()],
            [helper.make_tensor_value_info(n, kind, list(s)) for n, (_, s) in outputs.items()],
            list(self._constants.values()),
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
        )
        checker.check_model(model)
        return model


_NORM_EPSILON = 1e-5  # of torch's layer normalisation


# Parts of transformers over sets of features.
# Source: Vaswani et al., "Attention is all you need", NeurIPS 2017, sections 3.2 and 3.3.


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
        epsilon=_NORM_EPSILON,
    )


def gelu(graph: GraphBuilder, x: str) -> str:
    """`x` times the normal distribution function of x (Hendrycks and Gimpel 2016, equation 1)."""
    erf = graph.node("Erf", graph.node("Div", x, graph.constant(np.sqrt(2.0))))
    doubled = graph.node("Mul", x, graph.node("Add", erf, graph.constant(1.0)))
    return graph.node("Mul", doubled, graph.constant(0.5))
