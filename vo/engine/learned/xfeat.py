"""XFeat: its network as an ONNX graph, and features from its outputs.

Source: Potje et al., "XFeat: accelerated features for lightweight image matching", CVPR 2024.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import TYPE_CHECKING

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bytes, Floats, Floats32, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.graph import GraphBuilder, Tensor
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    MIN_SIDE_OF_32,
    bicubic,
    learned_keypoints,
    masked,
    network_input,
    no_keypoints,
    to_cells,
)

if TYPE_CHECKING:
    from onnx import ModelProto

_MULTIPLE = 32  # of both sides of the network's input
_MIN_HEAT = float(np.float32(0.05))
_RADIUS_PX = 2  # of the square in which a keypoint is the maximum
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
        found, score = ranked_peaks(heat[0, 0], image.shape, mask, reliability[0, 0], self._count)
        return (
            learned_keypoints(found, score, bicubic(features[0], to_cells(found))),
            learned_keypoints(xy, np.zeros(len(xy)), bicubic(features[0], to_cells(xy))),
        )


def ranked_peaks(
    heat: Floats32,
    shape: tuple[int, ...],
    mask: Bytes | None,
    reliability: Floats32,
    count: int,
) -> tuple[Floats, Floats]:
    """Positions (N, 2) x, y and scores of the strongest peaks of a heat map, strongest first.

    A peak is the maximum of the 5 x 5 pixels around it, and placed where parabolas through the
    logarithms of it and its neighbours, whose peaks are nearly parabolas, have their vertices.

    Args:
        heat: (H, W) probabilities of a keypoint.
        shape: the part of it that is the image; the rest is its continuation.
        mask: 0 where there are none, of this shape.
        reliability: (H/8, W/8) factors of the scores.
        count: of peaks at most.
    """
    height, width = shape
    # Before the search for maxima, so that results with masks keep their bits; other networks'
    # maxima are masked after it, so that no slope at the edge of a mask counts as one.
    if mask is not None:
        heat = masked(heat[:height, :width], mask)
    room, found = -1, height * width // (_RADIUS_PX + 1) ** 2  # more only with equal neighbours
    while found > room:
        room = found
        at, near = np.empty((room, 2), np.int32), np.empty((room, 5), np.float32)
        found = _find_peaks(heat, height, width, at, near)
    logarithms = np.log(np.maximum(near[:found], 1e-6))
    xy, score = np.empty((found, 2)), np.empty(found)
    _place_peaks(at, near, logarithms, reliability, xy, score)
    weakness = -score
    rows = np.arange(found)
    if found > count:
        rows = np.flatnonzero(weakness <= np.partition(weakness, count - 1)[count - 1])
    # Of equal ones by row and column.
    rows = rows[np.argsort(weakness[rows], kind="stable")][:count]
    return xy[rows], score[rows]


@compiled
def _find_peaks(heat, height, width, at, near):  # type: ignore[no-untyped-def]
    """Columns and rows of maxima and, for each, it and what is left, right, above and below.

    At an edge of the image the neighbours are 0. The number of all, though the first ones alone are
    written where there is no room for more.
    """
    found = 0
    for v in range(height):
        for u in range(width):
            peak = heat[v, u]
            if peak <= _MIN_HEAT:
                continue
            is_highest = True
            for j in range(max(v - _RADIUS_PX, 0), min(v + _RADIUS_PX + 1, height)):
                for i in range(max(u - _RADIUS_PX, 0), min(u + _RADIUS_PX + 1, width)):
                    if heat[j, i] > peak:
                        is_highest = False
                        break
                if not is_highest:
                    break
            if not is_highest:
                continue
            if found < len(at):
                at[found, 0], at[found, 1] = u, v
                near[found, :] = 0.0
                near[found, 0] = peak
                if 0 < u < width - 1:
                    near[found, 1], near[found, 2] = heat[v, u - 1], heat[v, u + 1]
                if 0 < v < height - 1:
                    near[found, 3], near[found, 4] = heat[v - 1, u], heat[v + 1, u]
            found += 1
    return found


@compiled
def _place_peaks(at, near, logarithms, reliability, xy, score):  # type: ignore[no-untyped-def]
    """Places of peaks between pixels, at most half of one from them, and their scores."""
    height, width = reliability.shape
    for n in range(len(logarithms)):
        peak = np.float64(logarithms[n, 0])
        for axis in range(2):
            before = np.float64(logarithms[n, 2 * axis + 1])
            after = np.float64(logarithms[n, 2 * axis + 2])
            curvature = before - 2.0 * peak + after
            offset = 0.0
            if curvature < -1e-9:
                offset = min(max(0.5 * (before - after) / curvature, -0.5), 0.5)
            xy[n, axis] = at[n, axis] + offset
        x = min(max((xy[n, 0] + 0.5) / _CELL - 0.5, 0.0), width - 1.0)
        y = min(max((xy[n, 1] + 0.5) / _CELL - 0.5, 0.0), height - 1.0)
        left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        a, b = x - left, y - top
        upper = reliability[top, left] * (1 - a) + reliability[top, right] * a
        lower = reliability[bottom, left] * (1 - a) + reliability[bottom, right] * a
        score[n] = near[n, 0] * (upper * (1 - b) + lower * b)


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
