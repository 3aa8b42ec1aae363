"""SuperPoint as an ONNX graph.

Source: DeTone et al., "SuperPoint: self-supervised interest point detection and description", CVPR
workshops 2018, section 3 and figure 3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.engine.learned.graph import GraphBuilder
from vo.engine.learned.torch_archive import Tensor

if TYPE_CHECKING:
    from onnx import ModelProto

_CELL = 8  # pixels of the image a side for each cell
SUPERPOINT_OUTPUTS = ("score", "descriptors")


def superpoint_model(weights: dict[str, Tensor]) -> ModelProto:
    """The model, from the weights by their names in the authors' file `superpoint_v1.pth`.

    Input `image`: (1, 1, H, W) grey, H and W multiples of 8. Outputs: `score` (1, 1, H, W)
    probability of a keypoint at each pixel, `descriptors` (1, D, H/8, W/8) of unit length.

    Raises:
        KeyError: a weight is missing.
    """
    graph = GraphBuilder(weights)
    x = "image"
    for block in range(1, 5):
        if block > 1:
            x = graph.node("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2])
        for part in "ab":
            x = graph.node("Relu", _convolution(graph, f"conv{block}{part}", x))
    cells = _head(graph, "P", x)
    # The last of the 65 channels stands for cells without a keypoint.
    probability = graph.node("Softmax", cells, axis=1)
    first, end, axis = (graph.constant([n], np.int64) for n in (0, _CELL * _CELL, 1))
    probability = graph.node("Slice", probability, first, end, axis)
    score = graph.node("DepthToSpace", probability, blocksize=_CELL)
    descriptors = graph.node("LpNormalization", _head(graph, "D", x), axis=1, p=2)
    width = graph.weight("convDb.weight").shape[0]
    outputs: dict[str, tuple[str, tuple[int | str, ...]]] = {
        "score": (score, (1, 1, "H", "W")),
        "descriptors": (descriptors, (1, width, "h", "w")),
    }
    return graph.model({"image": (1, 1, "H", "W")}, outputs, "superpoint")


def _head(graph: GraphBuilder, name: str, x: str) -> str:
    """Two convolutions: `P` finds keypoints, `D` describes."""
    x = graph.node("Relu", _convolution(graph, f"conv{name}a", x))
    return _convolution(graph, f"conv{name}b", x)


def _convolution(graph: GraphBuilder, name: str, x: str) -> str:
    weight = graph.weight(f"{name}.weight")
    bias = graph.weight(f"{name}.bias")
    return graph.convolution(x, weight, bias, padding=weight.shape[2] // 2)
