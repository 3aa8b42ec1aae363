"""XFeat: its network as an ONNX graph, and features from its outputs.

Source: Potje et al., "XFeat: accelerated features for lightweight image matching", CVPR 2024.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import TYPE_CHECKING

import cv2
import numpy as np

from vo.base.types import Bytes, Floats, Floats32, Ints, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.graph import GraphBuilder
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    MIN_SIDE_OF_32,
    bicubic,
    bilinear,
    learned_keypoints,
    masked,
    network_input,
    no_keypoints,
    parabola_offsets,
    to_cells,
)
from vo.engine.learned.torch_archive import Tensor

if TYPE_CHECKING:
    from onnx import ModelProto

_MULTIPLE = 32  # of both sides of the network's input
_MIN_HEAT = 0.05
_SUPPRESSION_PX = 5  # side of the square in which a keypoint is the maximum
_WIDTH = 64


class XFeatExtractor:
    """Detects and describes XFeat features, strongest first."""

    descriptor_format = DescriptorFormat(_WIDTH, np.dtype(np.float32))
    scale_factor = 1.0
    suits_mutual_matching = (
        True  # trained for it; a ratio test drops two fifths of the right matches
    )

    def __init__(self, inference: Inference, count: int) -> None:
        self._inference = inference
        self._count = count

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        return self.extract_and_describe(image, np.empty((0, 2)), mask)[0]

    def extract_and_describe(
        self, image: Bytes, xy: Floats, mask: Bytes | None = None
    ) -> tuple[Keypoints, Keypoints]:
        """Features of an image, and given pixels (N, 2) of it as features."""
        if min(image.shape) < MIN_SIDE_OF_32:
            unknown = learned_keypoints(xy, np.zeros(len(xy)), np.zeros((len(xy), _WIDTH)))
            return no_keypoints(_WIDTH), unknown
        given = network_input(image, _MULTIPLE)
        features, heat, reliability = self._inference.run({"image": given}, XFEAT_OUTPUTS)
        height, width = image.shape
        # Before the search for maxima, so that results with masks keep their bits; other networks'
        # maxima are masked after it, so that no slope at the edge of a mask counts as one.
        heat = masked(heat[0, 0, :height, :width], mask)
        v, u = maxima(heat)
        found = np.stack([u, v], axis=1) + peak_offsets(heat, v, u)
        score = heat[v, u] * bilinear(reliability[0, 0], to_cells(found))
        order = np.lexsort((u, v, -score))[: self._count]
        found, score = found[order], score[order]
        return (
            learned_keypoints(found, score, bicubic(features[0], to_cells(found))),
            learned_keypoints(xy, np.zeros(len(xy)), bicubic(features[0], to_cells(xy))),
        )


def maxima(heat: Floats32) -> tuple[Ints, Ints]:
    """Rows and columns of the pixels that are the maximum of the 5 x 5 around them."""
    kernel = np.ones((_SUPPRESSION_PX, _SUPPRESSION_PX), np.uint8)
    highest = cv2.dilate(heat, kernel)
    v, u = np.nonzero((heat == highest) & (heat > _MIN_HEAT))
    return v, u


def peak_offsets(heat: Floats32, v: Ints, u: Ints) -> Floats:
    """(N, 2) x, y from maxima to the vertices of parabolas through them and their neighbours.

    Of the logarithm, whose peaks are nearly parabolas; at most half a pixel, 0 at the border.
    """
    return parabola_offsets(heat, v, u, lambda near: np.log(np.maximum(near, 1e-6)))


XFEAT_OUTPUTS = ("feats", "heat", "rel")
_CELL = 8  # pixels of the image a side for each cell of the feature map
_LAYERS = {  # stride and side of the kernel of each layer of a block
    "block1": [(1, 3), (2, 3), (1, 3), (2, 3)],
    "block2": [(1, 3), (1, 3)],
    "block3": [(2, 3), (1, 3), (1, 1)],
    "block4": [(2, 3), (1, 3), (1, 3)],
    "block5": [(2, 3), (1, 3), (1, 3), (1, 1)],
    "block_fusion": [(1, 3), (1, 3)],
    "heatmap_head": [(1, 1), (1, 1)],
    "keypoint_head": [(1, 1), (1, 1), (1, 1)],
}


def xfeat_model(weights: dict[str, Tensor]) -> ModelProto:
    """The model, from the weights by their names in the authors' file.

    Input `image`: (1, 1, H, W) grey, H and W multiples of 32. Outputs: `feats` (1, 64, H/8, W/8)
    descriptors of unit length, `heat` (1, 1, H, W) probability of a keypoint at each pixel, `rel`
    (1, 1, H/8, W/8) reliability.

    Raises:
        KeyError: a weight is missing.

    Source: the paper, figure 3 and section 3.
    """
    weights = {name.removeprefix("net."): tensor for name, tensor in weights.items()}
    graph = GraphBuilder(weights)
    image = _instance_normalised(graph, "image")
    x1 = _block(graph, "block1", image)
    pooled = graph.node("AveragePool", image, kernel_shape=[4, 4], strides=[4, 4])
    skip = graph.convolution(pooled, graph.weight("skip1.1.weight"), graph.weight("skip1.1.bias"))
    x2 = _block(graph, "block2", graph.node("Add", x1, skip))
    x3 = _block(graph, "block3", x2)
    x4 = _block(graph, "block4", x3)
    x5 = _block(graph, "block5", x4)
    fused = graph.node(
        "Add", graph.node("Add", x3, _enlarged(graph, x4, 2)), _enlarged(graph, x5, 4)
    )
    features = _with_last(graph, "block_fusion", fused, 2)
    reliability = graph.node("Sigmoid", _with_last(graph, "heatmap_head", features, 2))
    cells = _cells(graph, image)
    logits = _with_last(graph, "keypoint_head", cells, 3)
    outputs = {
        "feats": (_unit_length(graph, features), (1, 64, "h", "w")),
        "heat": (_heatmap(graph, logits), (1, 1, "H", "W")),
        "rel": (reliability, (1, 1, "h", "w")),
    }
    return graph.model({"image": (1, 1, "H", "W")}, outputs, "xfeat")


def _block(graph: GraphBuilder, name: str, x: str) -> str:
    """Convolutions, each with batch normalisation and ReLU."""
    for number, (stride, side) in enumerate(_LAYERS[name]):
        layer = f"{name}.{number}.layer"
        kernel, bias = graph.normalised(
            graph.weight(f"{layer}.0.weight"),
            graph.weight(f"{layer}.1.running_mean"),
            graph.weight(f"{layer}.1.running_var"),
        )
        x = graph.node("Relu", graph.convolution(x, kernel, bias, stride, (side - 1) // 2))
    return x


def _with_last(graph: GraphBuilder, name: str, x: str, last: int) -> str:
    """A block, and a convolution of single pixels after it."""
    x = _block(graph, name, x)
    return graph.convolution(
        x, graph.weight(f"{name}.{last}.weight"), graph.weight(f"{name}.{last}.bias")
    )


def _instance_normalised(graph: GraphBuilder, x: str) -> str:
    """The image with zero mean and unit variance."""
    return graph.node(
        "InstanceNormalization", x, graph.constant([1.0]), graph.constant([0.0]), epsilon=1e-5
    )


def _enlarged(graph: GraphBuilder, x: str, factor: int) -> str:
    """Bilinear interpolation to a multiple of the size, pixel areas aligned."""
    scales = graph.constant([1.0, 1.0, factor, factor])
    return graph.node(
        "Resize", x, "", scales, mode="linear", coordinate_transformation_mode="half_pixel"
    )


def _cells(graph: GraphBuilder, image: str) -> str:
    """(1, 64, H/8, W/8): the 8 x 8 pixels of each cell as channels, row by row."""
    return graph.node("SpaceToDepth", image, blocksize=_CELL)


def _heatmap(graph: GraphBuilder, logits: str) -> str:
    """(1, 1, H, W) probabilities: softmax over the pixels of a cell and "none of them"."""
    probability = graph.node("Softmax", logits, axis=1)
    pixels = graph.node(
        "Slice",
        probability,
        graph.constant([0], np.int64),
        graph.constant([_CELL * _CELL], np.int64),
        graph.constant([1], np.int64),
    )
    return graph.node("DepthToSpace", pixels, blocksize=_CELL, mode="DCR")


def _unit_length(graph: GraphBuilder, x: str) -> str:
    squared = graph.node("ReduceSum", graph.node("Mul", x, x), graph.constant([1], np.int64))
    length = graph.node("Max", graph.node("Sqrt", squared), graph.constant([1e-12]))
    return graph.node("Div", x, length)
